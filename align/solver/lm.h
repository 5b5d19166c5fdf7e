#pragma once
#include <optional>

#include <iclk/align/aligner.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// The input of the damped steps of one pair, apart from the sums.
struct LmProblem {
  const AlignerOptions* options = nullptr;
  const PosePrior* prior = nullptr;  ///< or null
  double mean_inverse_depth = 0;     ///< of the reference's mask, to convert translations to pixels
};

/// H of the pose at a point: its columns are multiplied by the gain, and gain and bias are marginalised out. Divided by the
/// variance of the residuals it is information.
Matrix6d pose_information(const NormalSums& sums, const Point& at, bool photometric);

/// The Hessian of the prior's cost at a pose: e(T Exp(xi)^-1) = e - J_r^-1(e) xi, so J_r^-T information J_r^-1.
Matrix6d prior_information(const PosePrior& prior, const SE3& T_10);

/// The Levenberg-Marquardt iterations of one pair; the caller evaluates the sums. The device solver runs the same steps in
/// shaders/align/lm_step.glsl.
class LmIteration {
 public:
  LmIteration() = default;
  LmIteration(const LmProblem& problem, const SE3& T_10) : problem_(problem) {
    point_.T_10 = T_10;
    if (problem.prior) belief_ = *problem.prior;
  }

  /// Sets gain and bias from the standard deviations and means of both images. While the images are still far apart, a
  /// regression would be biased towards gain 0. Precondition: `sums` are those at gain 1, bias 0.
  void start_photometric(const NormalSums& sums);

  /// Begins a level. Damping is reset; the pose is kept, and the previous level's share of information about it
  /// (AlignerOptions::carry).
  void begin_level(const Camera& level_camera);

  /// Judges the last step by the sums at point(), and takes the next step.
  IterationTrace step(const NormalSums& sums);
  /// Judges the last step of a level by the sums after it.
  void end_level(const NormalSums& sums);

  /// The point to evaluate next; after end_level() the result.
  const Point& point() const { return point_; }
  bool level_done() const { return done_; }         ///< the last step was below the tolerance, or there was none
  bool singular() const { return singular_; }       ///< the system had no solution
  double last_step() const { return last_step_; }   ///< px of the level
  const NormalSums& sums() const { return sums_; }  ///< at point(); precondition: end_level() was called

 private:
  struct System {
    Matrix8d H;
    Vector8d g;
    double objective;
  };
  System system(const NormalSums& sums, const Point& at, double variance) const;
  double residual_variance(const NormalSums& sums) const;
  void believe();                      // keeps the level's information about the pose
  bool judge(const NormalSums& sums);  // true: the evaluated point is the accepted one
  void propose();

  LmProblem problem_;
  std::optional<PosePrior> belief_;  // the prior and the information of coarser levels
  double variance_ = 1;              // of a residual, at the accepted point
  Point point_, accepted_;
  NormalSums sums_;
  System accepted_system_;
  double focal_ = 1;
  double lambda_ = 0, nu_ = 2;
  double predicted_ = 0;  // decrease of the objective that the linear model predicts
  double last_step_ = 0;
  bool has_accepted_ = false, done_ = false, singular_ = false;
};

}  // namespace iclk::internal
