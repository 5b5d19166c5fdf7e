#pragma once
#include <string>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/se3.h>

namespace iclk {

enum class Status {
  converged,
  max_iterations,    ///< the finest level was still moving when its iterations were used up
  low_overlap,       ///< too few patch pixels fall into the target
  degenerate,        ///< H is singular or ill-conditioned: the images do not determine the pose
  too_few_features,  ///< fewer usable features than AlignerOptions::min_features
  diverged,          ///< the images do not agree at the pose where the iterations ended
  ambiguous,         ///< another pose explains the images as well: RefinedAlignment::rivals
};
const char* name(Status status);
/// converged or max_iterations: the pose is an answer, and has a covariance.
constexpr bool usable(Status status) { return status == Status::converged || status == Status::max_iterations; }

struct IterationTrace {
  SE3 T_10;            ///< after this iteration
  double cost = 0;     ///< mean weighted squared residual before the step
  double visible = 0;  ///< share of mask pixels inside the target before the step
  double step = 0;     ///< motion of the step, px of this level
  double lambda = 0;
  bool accepted = true;
};

struct LevelTrace {
  int level = 0;
  double scale = 0;  ///< robust scale of the residual with which the level started; 0: unit weights
  std::vector<IterationTrace> iterations;
};

/// What an alignment gives, the same from every solver.
struct Alignment {
  SE3 T_10;  ///< pose: camera 0 to camera 1
  Status status = Status::diverged;
  std::string reason;             ///< the status in words, with the numbers that decided it
  Matrix6d H = Matrix6d::Zero();  ///< J^T W J at the finest level's last iteration, [rho, phi]; gain and bias marginalised out
  /// Of [rho, phi], T_10 = mean Exp(xi), a prior included; zero unless the status is converged or max_iterations. With s^2 the
  /// residuals' variance and H_c the part of H that both images confirm: s^2 H_c^-1 H H_c^-1. Where H is inflated by noise,
  /// s^2 H^-1 would be too small; and as pixels of a patch are wrong together, what the images say of H counts
  /// internal::Agreement::variance_ratio() times in the middle.
  Matrix6d covariance = Matrix6d::Zero();
  double cost = 0;                     ///< mean weighted squared residual at the end, feature units squared
  double correlation = 0;              ///< of f0 and the warped f1 over visible mask pixels at the end, in [-1, 1]
  double agreement = 0;                ///< of both images' gradients in the pose's worst direction, in [-1, 1]
  double visible_fraction = 0;         ///< share of the finest level's mask pixels inside the target at the end
  double gain = 1, bias = 0;           ///< f1 = gain f0 + bias
  std::vector<LevelTrace> levels;      ///< coarse to fine
  std::vector<FeatureCheck> features;  ///< one verdict a feature of the reference; empty in dense mode

  bool converged() const { return status == Status::converged; }
};

}  // namespace iclk
