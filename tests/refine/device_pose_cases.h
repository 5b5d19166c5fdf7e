#pragma once
#include <vector>

#include <iclk/refine/refiner.h>
#include <iclk/shaders/refine/refine.h>

#include "correspondences.h"

namespace iclk::test {

/// A pair as feature alignment would leave it, started at `T_10`.
struct Case {
  Camera camera;
  Features features;
  std::vector<AlignedFeature> aligned;
  SE3 T_10;
  Matrix6d iclk_covariance = Matrix6d::Identity();
  bool search = true;
};

struct Outcome {
  shaders::RefinedInfo info;
  shaders::RefineState state;
  shaders::FeatureTask task;  ///< of the next round
  SE3 T_10;
  Matrix6d covariance;
};

/// What the shaders make of the pairs, in one round.
std::vector<Outcome> run(const std::vector<Case>& cases, const RefinerOptions& options = {});

/// Features of a scene with errors, and a pose nearby.
Case case_of(const Scene& scene, int count, double sigma, double outliers, uint32_t seed, double depth_error = 0);

/// px: the most by which the poses differ at the features.
double motion(const Case& c, const SE3& a, const SE3& b);

}  // namespace iclk::test
