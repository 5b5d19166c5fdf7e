#pragma once
#include <span>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/track/internal/edge_cost.h>

namespace iclk::internal {

/// A keyframe of a bundle: its pose, and its features with priors of their inverse depths.
struct BundleFrame {
  SE3 T_WC;
  bool fixed = false;  ///< pose and inverse depths are constant
  std::vector<Eigen::Vector2d> uv;
  std::vector<double> inverse_depth;
  std::vector<double> prior, prior_sigma;  ///< of inverse_depth: mean and standard deviation; sigma 0: none
};

/// The position of feature `feature` of frame `frame` in the image of frame `seen_in`.
struct BundleSighting {
  int frame = 0, feature = 0, seen_in = 0;
  Eigen::Vector2d uv;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< px^2
};

struct BundleOptions {
  double floor = 0.2;  ///< px: the error of a sharp sighting, a lower bound of every standard deviation
  int iterations = 12;
};

struct BundleResult {
  bool usable = false;  ///< the frames were changed
  double initial_cost = 0, cost = 0;
  int sightings = 0;
};

/// Adjusts poses and inverse depths of all frames together:
///
///   min sum rho(|W (project(T_jW T_Wi ray / q) - uv)|^2) + sum ((q - prior) / sigma)^2 + sum |xi|^2 of the edges
///
/// with W = (covariance + floor^2 I)^-1/2 and the Cauchy loss; inverse depths are eliminated first. Sightings behind a camera
/// are left out. If no frame is fixed, the first one is. Precondition: all indices are valid.
BundleResult adjust(const Camera& camera, std::span<BundleFrame> frames, std::span<const BundleSighting> sightings,
                    std::span<const BundleEdge> edges = {}, const BundleOptions& options = {});

}  // namespace iclk::internal
