#pragma once
#include <random>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/refine/internal/turn.h>

namespace iclk::test {

inline Eigen::Matrix3d rotation(const Eigen::Vector3d& phi) {
  return SE3::exp((Vector6d() << Eigen::Vector3d::Zero(), phi).finished()).R;
}

/// A pair of 640x480 whose depths have `depth_error` of their length, as features of the refiner.
struct BentPair {
  Camera camera{520, 520, 319.5, 239.5, 640, 480};
  SE3 T_10 = SE3::exp((Vector6d() << 0.02, -0.01, 0.03, 0.01, -0.04, 0.02).finished());
  Features features;
  std::vector<AlignedFeature> aligned;

  BentPair(const Eigen::Vector3d& turn, double depth_error, double outliers, std::mt19937_64& random) {
    std::uniform_real_distribution<double> u(20, 620), v(20, 460), depth(1, 5), any(0, 1);
    std::normal_distribution<double> normal;
    while (features.uv.size() < 150) {
      const Eigen::Vector2d uv0(u(random), v(random));
      const double z = depth(random);
      const Eigen::Vector3d p = T_10.R * camera.ray(uv0) + T_10.t / z;
      Eigen::Vector2d uv1 = camera.project(p);
      for (int i = 0; i < 20; ++i) uv1 = camera.project(rotation(-turn * row_time(camera, uv1.y())) * p);
      if (!(uv1.x() > 8 && uv1.y() > 8 && uv1.x() < 631 && uv1.y() < 471)) continue;
      uv1 += 0.3 * Eigen::Vector2d(normal(random), normal(random));
      if (any(random) < outliers) uv1 += Eigen::Vector2d(24 * any(random) - 12, 24 * any(random) - 12);
      features.uv.push_back(uv0);
      features.inverse_depth.push_back(1 / (z * (1 + depth_error * normal(random))));
      AlignedFeature f;
      f.status = FeatureStatus::aligned;
      f.uv1 = uv1;
      f.covariance = 0.01 * Eigen::Matrix2d::Identity();
      aligned.push_back(f);
    }
  }
};

}  // namespace iclk::test
