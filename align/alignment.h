#pragma once
#include <string>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/se3.h>

namespace iclk {

enum class Status {
  converged,
  max_iterations,    ///< the pose was still moving after the last iteration of the finest level
  low_overlap,       ///< too few patch pixels fall into the target
  degenerate,        ///< H is singular or ill-conditioned: the images do not determine the pose
  too_few_features,  ///< fewer usable features than AlignerOptions::min_features
  diverged,          ///< the images do not agree at the final pose
  ambiguous,         ///< another pose fits the images as well: RefinedAlignment::rivals
};
const char* name(Status status);
/// Whether the pose is usable and has a covariance: converged or max_iterations.
constexpr bool usable(Status status) { return status == Status::converged || status == Status::max_iterations; }

/// One iteration of a level.
struct IterationTrace {
  SE3 T_10;            ///< after this iteration
  double cost = 0;     ///< mean weighted squared residual before the step
  double visible = 0;  ///< share of mask pixels inside the target before the step, in [0, 1]
  double step = 0;     ///< image motion of the step, px of this level
  double lambda = 0;
  bool accepted = true;
};

struct LevelTrace {
  int level = 0;
  double scale = 0;  ///< robust scale of the residual at the start of the level; 0: unit weights
  std::vector<IterationTrace> iterations;
};

/// The result of an alignment, the same for every solver.
struct Alignment {
  SE3 T_10;  ///< pose: camera 0 to camera 1
  Status status = Status::diverged;
  std::string reason;  ///< explains the status, with the numbers that decided it
  /// J^T W J at the last iteration of the finest level, for [rho, phi]; gain and bias are marginalised out.
  Matrix6d H = Matrix6d::Zero();
  /// The covariance of xi = [rho, phi] with T_10 = mean Exp(xi); zero unless usable(status). It includes a prior.
  ///
  ///   covariance = s^2 H_c^-1 (H + (k - 1) H_I) H_c^-1
  ///
  /// s^2 is the variance of the residuals. H_c is the part of H that both images confirm: noise inflates H, so s^2 H^-1 would
  /// be too small. Errors of the pixels of a patch are correlated; this multiplies the images' part H_I of H by
  /// k = internal::Agreement::variance_ratio(). Priors are included in H and H_c.
  Matrix6d covariance = Matrix6d::Zero();
  double cost = 0;                     ///< mean weighted squared residual at the end, feature units squared
  double correlation = 0;              ///< of f0 and the warped f1 over visible mask pixels at the end, in [-1, 1]
  double agreement = 0;                ///< correlation of both images' gradients in the worst direction of the pose, in [-1, 1]
  double visible_fraction = 0;         ///< share of the finest level's mask pixels inside the target at the end, in [0, 1]
  double repeats = 0;                  ///< share of the features that look the same elsewhere in the target; 0 without a search
  double gain = 1, bias = 0;           ///< f1 = gain f0 + bias
  std::vector<LevelTrace> levels;      ///< coarse to fine
  std::vector<FeatureCheck> features;  ///< one verdict per feature of the reference; empty in dense mode

  bool converged() const { return status == Status::converged; }
};

}  // namespace iclk
