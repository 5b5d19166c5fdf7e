#include <iclk/align/internal/verdict.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <Eigen/Dense>

namespace iclk::internal {
namespace {

template <class... A>
std::string format(const char* text, A... values) {
  char buffer[256];
  std::snprintf(buffer, sizeof buffer, text, values...);
  return buffer;
}

// A pose that the images leave uncertain by more than this is not determined by them.
constexpr double kLargestSigma = 1.0;  // px
// Variance of rounding to 8 bits with some noise: residuals cannot be known to be better, however small they came out.
constexpr double kLeastVariance = 1.0 / (510.0 * 510.0);
// Of H scaled to a unit diagonal. Device sums are single precision, good to about 1e-6 of the diagonal.
constexpr double kLeastEigenvalue = 1e-5;

// H of the pose with gain and bias marginalised out, and with the gain's factor on the pose's columns.
Matrix6d pose_information(const NormalSums& sums, const Point& at, bool photometric) {
  Matrix6d H = at.gain * at.gain * sums.H.topLeftCorner<6, 6>();
  if (!photometric) return H;
  const Eigen::Matrix<double, 6, 2> B = at.gain * sums.H.topRightCorner<6, 2>();
  const Eigen::Matrix2d C = sums.H.bottomRightCorner<2, 2>();
  if (std::abs(C.determinant()) > 1e-12 * C(0, 0) * C(1, 1)) H -= B * C.ldlt().solve(B.transpose());
  return 0.5 * (H + H.transpose());
}

}  // namespace

void conclude(const Ending& ending, const AlignerOptions& options, Alignment& out) {
  const NormalSums& sums = ending.sums;
  out.T_10 = ending.point.T_10;
  out.gain = ending.point.gain;
  out.bias = ending.point.bias;
  out.visible_fraction = sums.visible_fraction();
  out.cost = sums.mean_cost();
  out.correlation = sums.correlation(ending.point);
  out.H = pose_information(sums, ending.point, options.photometric);
  out.covariance.setZero();
  const auto end = [&](Status status, const std::string& reason) {
    out.status = status;
    out.reason = reason;
  };

  if (!out.T_10.matrix().allFinite() || !out.H.allFinite() || !std::isfinite(out.cost)) {
    out.H.setZero();
    return end(Status::diverged, "the iterations left the finite numbers");
  }
  if (sums.visible == 0 || out.visible_fraction < options.min_visible)
    return end(Status::low_overlap, format("%.0f %% of the reference's pixels fall into the target, %.0f %% needed",
                                           100 * out.visible_fraction, 100 * options.min_visible));

  const Vector6d diagonal = out.H.diagonal();
  if (ending.singular || !(diagonal.minCoeff() > 0))
    return end(Status::degenerate, "the images have no texture that would determine the pose (H is singular)");
  const Vector6d scale = diagonal.cwiseSqrt().cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(scale.asDiagonal() * out.H * scale.asDiagonal());
  const double least = eigen.eigenvalues()(0);
  if (!(least > kLeastEigenvalue))
    return end(Status::degenerate,
               format("H is ill-conditioned: least eigenvalue %.1e of its scaled form, %.0e needed", least, kLeastEigenvalue));
  const Matrix6d inverse = scale.asDiagonal() * eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() *
                           eigen.eigenvectors().transpose() * scale.asDiagonal();
  const double freedom = std::max(sums.visible - (options.photometric ? 8 : 6), 1.0);
  const double variance = std::max(sums.cost / freedom, kLeastVariance);
  out.covariance = variance * inverse;
  const double focal = std::max(std::abs(ending.camera.fx), std::abs(ending.camera.fy));
  const double sigma = focal * (std::sqrt(out.covariance.bottomRightCorner<3, 3>().trace()) +
                                ending.mean_inverse_depth * std::sqrt(out.covariance.topLeftCorner<3, 3>().trace()));
  const auto without_covariance = [&](Status status, const std::string& reason) {
    out.covariance.setZero();
    end(status, reason);
  };
  if (sigma > kLargestSigma * std::max(1.0, focal / 500))
    return without_covariance(Status::degenerate,
                              format("too little texture: the pose is uncertain by %.2g px (standard deviation)", sigma));
  if (out.correlation < options.min_correlation)
    return without_covariance(Status::diverged,
                              format("the images do not agree where the iterations ended: correlation %.2f, %.2f needed",
                                     out.correlation, options.min_correlation));
  if (ending.last_step > still_moving(options))
    return end(Status::max_iterations,
               format("still moving by %.3f px after %d iterations at the finest level", ending.last_step, options.iterations));
  end(Status::converged, format("correlation %.2f, %.0f %% visible, last step %.4f px", out.correlation,
                                100 * out.visible_fraction, ending.last_step));
}

double still_moving(const AlignerOptions& options) { return std::max(10 * options.step_tolerance, 0.05); }

bool enough_to_align(std::span<const FeatureCheck> checks, double mean_inverse_depth, const Plan& plan,
                     const AlignerOptions& options) {
  return plan.dense ? mean_inverse_depth > 0 : count_ok(checks) >= options.min_features;
}

Alignment too_few_features(const std::vector<FeatureCheck>& checks, const SE3& T_10, const AlignerOptions& options) {
  Alignment a;
  a.T_10 = T_10;
  a.features = checks;
  a.status = Status::too_few_features;
  a.reason = summary(checks) + ", at least " + std::to_string(options.min_features) + " needed";
  return a;
}

}  // namespace iclk::internal
