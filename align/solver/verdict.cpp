#include <iclk/align/solver/verdict.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include <Eigen/Dense>

#include <iclk/align/solver/lm.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

template <class... A>
std::string format(const char* text, A... values) {
  char buffer[256];
  std::snprintf(buffer, sizeof buffer, text, values...);
  return buffer;
}

// Information about the pose in units of the residual's variance, gain and bias marginalised out.
struct Evidence {
  Matrix6d H;          // with the prior
  Matrix6d image;      // without the prior
  Matrix6d confirmed;  // the part of H that is in both images
  Matrix6d cross;      // of the gradients of both images
  Matrix6d both;       // mean of each image's own
};

Evidence evidence_of(const Ending& ending, const Matrix6d& H, double variance) {
  const double a = ending.point.gain;
  const Matrix6d own = a * a * ending.sums.H.topLeftCorner<6, 6>();
  Evidence e{H, H, H - own + a * ending.agreement.cross, a * ending.agreement.cross, 0.5 * (own + ending.agreement.target)};
  if (ending.prior) {  // a prior needs no confirmation by images
    const Matrix6d prior = variance * prior_information(*ending.prior, ending.point.T_10);
    for (Matrix6d* m : {&e.H, &e.confirmed, &e.cross, &e.both}) *m += prior;
  }
  return e;
}

// The least value of x^T A x / x^T B x; NaN if B is not positive definite.
double least_ratio(const Matrix6d& A, const Matrix6d& B) {
  const Eigen::LLT<Matrix6d> llt(B);
  if (llt.info() != Eigen::Success) return std::numeric_limits<double>::quiet_NaN();
  const Matrix6d left = llt.matrixL().solve(A);
  const Matrix6d ratio = llt.matrixL().solve(left.transpose());
  return Eigen::SelfAdjointEigenSolver<Matrix6d>(ratio, Eigen::EigenvaluesOnly).eigenvalues()(0);
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
  out.repeats = ending.repeats;
  out.covariance.setZero();
  const auto end = [&](Status status, const std::string& reason) {
    out.status = status;
    out.reason = reason;
  };

  if (!out.T_10.matrix().allFinite() || !out.H.allFinite() || !std::isfinite(out.cost)) {
    out.H.setZero();
    return end(Status::diverged, "the iterations produced numbers that are not finite");
  }
  if (sums.visible == 0 || out.visible_fraction < options.min_visible)
    return end(Status::low_overlap, format("%.0f %% of the pixels of the reference fall into the target, %.0f %% needed",
                                           100 * out.visible_fraction, 100 * options.min_visible));

  const double freedom = std::max(sums.visible - (options.photometric ? 8 : 6), 1.0);
  const double variance = std::max(sums.cost / freedom, ICLK_LEAST_SIGMA * ICLK_LEAST_SIGMA);
  const Evidence evidence = evidence_of(ending, out.H, variance);
  const Vector6d diagonal = evidence.H.diagonal();
  if (!sums.textured(ending.point))
    return end(Status::degenerate, "an image is constant at the features: it has no texture that determines the pose");
  if (ending.singular || !(diagonal.minCoeff() > 0))
    return end(Status::degenerate, "the images have no texture that determines the pose (H is singular)");
  const Vector6d unit = diagonal.cwiseSqrt().cwiseInverse();
  const auto scale = unit.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(scale * evidence.H * scale, Eigen::EigenvaluesOnly);
  const double least = eigen.eigenvalues()(0);
  if (!(least > ICLK_LEAST_EIGENVALUE))
    return end(Status::degenerate, format("H is ill-conditioned: smallest eigenvalue %.1e after scaling, %.0e needed", least,
                                          ICLK_LEAST_EIGENVALUE));
  if (out.correlation < options.min_correlation)
    return end(Status::diverged, format("the images do not agree at the final pose: correlation %.2f, %.2f needed",
                                        out.correlation, options.min_correlation));

  const Matrix6d cross = scale * evidence.cross * scale, both = scale * evidence.both * scale;
  const double overall = cross.trace() / both.trace();
  out.agreement = least_ratio(cross, both);
  if (!(overall >= options.min_agreement))
    return end(Status::diverged, format("the image gradients do not agree at the final pose: agreement %.2f, %.2f needed",
                                        overall, options.min_agreement));
  const Eigen::LLT<Matrix6d> confirmed(scale * evidence.confirmed * scale);
  if (!(out.agreement >= options.min_agreement) || confirmed.info() != Eigen::Success)
    return end(Status::degenerate,
               format("the texture that both images share leaves one direction of the pose open: agreement %.2f, %.2f needed",
                      out.agreement, options.min_agreement));
  const Matrix6d inverse = scale * confirmed.solve(Matrix6d::Identity()) * scale;
  const Matrix6d covariance = variance * inverse * evidence.H * inverse;
  const double focal = std::max(std::abs(ending.camera.fx), std::abs(ending.camera.fy));
  const double sigma = focal * (std::sqrt(covariance.bottomRightCorner<3, 3>().trace()) +
                                ending.mean_inverse_depth * std::sqrt(covariance.topLeftCorner<3, 3>().trace()));
  if (!(sigma <= ICLK_LARGEST_SIGMA * std::max(1.0, focal / 500)))
    return end(Status::degenerate, format("too little texture: the pose is uncertain by %.2g px (standard deviation)", sigma));
  if (!ending.prior && ending.repeats >= ICLK_MATCH_REPEATS)
    return end(Status::degenerate,
               format("the texture repeats: %.0f %% of the features look the same elsewhere in the target, so "
                      "other poses fit as well; a first guess selects one",
                      100 * ending.repeats));
  const double more = ending.agreement.variance_ratio(options.photometric ? 8 : 6) - 1;
  const Matrix6d dependent = covariance + more * variance * inverse * evidence.image * inverse;
  out.covariance = 0.5 * (dependent + dependent.transpose());
  if (ending.last_step > still_moving(options))
    return end(Status::max_iterations,
               format("still moving by %.3f px after %d iterations at the finest level", ending.last_step, options.iterations));
  end(Status::converged, format("correlation %.2f, agreement of gradients %.2f, %.0f %% visible, last step %.4f px",
                                out.correlation, out.agreement, 100 * out.visible_fraction, ending.last_step));
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
