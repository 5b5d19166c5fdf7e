#pragma once
#include <span>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/pyramid.h>
#include <iclk/align/solver/level.h>

namespace iclk::internal {

using Matrix8d = Eigen::Matrix<double, 8, 8>;
using Vector8d = Eigen::Matrix<double, 8, 1>;

/// Pose, gain and bias of the residuals r = f1(warp(u; T_10)) - (gain f0(u) + bias).
struct Point {
  SE3 T_10;
  double gain = 1, bias = 0;
};

/// Sums over the visible mask pixels of one pair at one level, in the order [rho, phi, gain, bias]. The columns of the pose are
/// those of the template; the solver multiplies them by Point::gain.
struct NormalSums {
  Matrix8d H = Matrix8d::Zero();  ///< sum w J^T J
  Vector8d g = Vector8d::Zero();  ///< sum w J^T r
  double cost = 0;                ///< sum w r^2
  double visible = 0;             ///< number of visible mask pixels
  double masked = 0;              ///< number of mask pixels

  double weight() const { return H(7, 7); }
  double visible_fraction() const { return masked > 0 ? visible / masked : 0; }
  double mean_cost() const { return weight() > 0 ? cost / weight() : 0; }
  /// The correlation of f0 and the warped f1 over the weighted pixels, from the moments in H and g. 0 if one is constant.
  double correlation(const Point& at) const;
  /// Whether both are not constant.
  bool textured(const Point& at) const;

 private:
  struct Moments {
    double v0, v1, v01;  // variances and covariance, times the weight
    double m0, m1;       // sums of the magnitudes of the terms of v0 and v1
  };
  Moments moments(const Point& at) const;
};

/// The residual of each element at a point; NaN for pixels outside the mask and invisible ones.
std::vector<float> residuals(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at);

/// Computes the sums. `weights`: one per element; empty: 1. Invisible pixels are left out.
NormalSums normal_equations(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at,
                            std::span<const float> weights);

}  // namespace iclk::internal
