#pragma once
#include <random>
#include <vector>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include <iclk/refine/feature_alignment.h>

#include "../support/synthetic.h"

namespace iclk::test {

/// 640x480, f = 450 px, a plane 80 away, a motion of about 15 px.
inline Scene wide_scene() {
  Scene scene;
  scene.camera = {450, 450, 319.5, 239.5, 640, 480};
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, 0.015;
  scene.T_10 = SE3::exp(xi);
  return scene;
}

/// Features as feature alignment would bring them: the truth with Gaussian noise (px), a share moved by up to 4 px each way.
inline std::vector<AlignedFeature> correspondences(const Scene& scene, const Features& features, double sigma,
                                                   std::mt19937& random, double outliers = 0) {
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<AlignedFeature> aligned(features.uv.size());
  for (size_t i = 0; i < aligned.size(); ++i) {
    aligned[i].status = FeatureStatus::aligned;
    if (!features.uv[i].allFinite()) continue;
    aligned[i].uv1 = scene.truth(features.uv[i]) + sigma * Eigen::Vector2d(normal(random), normal(random));
    if (uniform(random) < outliers) aligned[i].uv1 += Eigen::Vector2d(8 * uniform(random) - 4, 8 * uniform(random) - 4);
  }
  return aligned;
}

inline Scene deep_scene() {  // of strong parallax: the plane is steep and the motion along it
  Scene scene = wide_scene();
  scene.normal = {0.6, -0.4, 1};
  scene.T_10.t = {6, -2, 1};
  return scene;
}

/// Largest relative difference of the standard deviations along any direction: of the eigenvalues of A^-1 B from 1.
inline double difference(const Matrix6d& A, const Matrix6d& B) {
  const Matrix6d ratio = A.inverse() * B;
  double worst = 0;
  for (const auto& value : ratio.eigenvalues()) worst = std::max(worst, std::abs(std::sqrt(std::abs(value)) - 1));
  return worst;
}

/// 3x4, row-major.
inline void pack_pose(const SE3& T, float* m) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) m[4 * i + j] = static_cast<float>(T.R(i, j));
    m[4 * i + 3] = static_cast<float>(T.t(i));
  }
}
inline SE3 unpack_pose(const float* m) {
  SE3 T;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T.R(i, j) = m[4 * i + j];
    T.t(i) = m[4 * i + 3];
  }
  return T;
}

}  // namespace iclk::test
