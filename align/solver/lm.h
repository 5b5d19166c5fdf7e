#pragma once
#include <optional>

#include <iclk/align/aligner.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// What the damped steps of one pair need beside the sums.
struct LmProblem {
  const AlignerOptions* options = nullptr;
  const PosePrior* prior = nullptr;  ///< or null
  double mean_inverse_depth = 0;     ///< of the reference's mask: turns a translation into pixels
};

/// What the sums at a point say of the pose: H with the gain's factor on its columns, gain and bias marginalised out. Times
/// the inverse variance of the residuals it is information.
Matrix6d pose_information(const NormalSums& sums, const Point& at, bool photometric);

/// Hessian of the prior's cost at a pose: e(T Exp(xi)^-1) = e - J_r^-1(e) xi, so J_r^-T information J_r^-1.
Matrix6d prior_information(const PosePrior& prior, const SE3& T_10);

/// The 6-DoF Levenberg-Marquardt iteration of one pair, one evaluation of the sums at a time. The device solver runs the same
/// steps in shaders/align/lm_step.glsl.
class LmIteration {
 public:
  LmIteration() = default;
  LmIteration(const LmProblem& problem, const SE3& T_10) : problem_(problem) {
    point_.T_10 = T_10;
    if (problem.prior) belief_ = *problem.prior;
  }

  /// Gain and bias from the moments of both images (standard deviations and means): a regression would be biased towards 0
  /// while the images are still far apart. `sums` taken at gain 1, bias 0.
  void start_photometric(const NormalSums& sums);

  /// Level camera of the steps to come. Damping starts anew; the pose stays, and so does what the level before has found out
  /// about it (AlignerOptions::carry).
  void begin_level(const Camera& level_camera);

  /// The sums at point() arrived: judge the step that led there, take the next one.
  IterationTrace step(const NormalSums& sums);
  /// The sums after the last step of a level: judge only.
  void end_level(const NormalSums& sums);

  /// Where to evaluate next, and after end_level the result.
  const Point& point() const { return point_; }
  bool level_done() const { return done_; }         ///< moved less than the tolerance, or cannot move
  bool singular() const { return singular_; }       ///< the system had no solution
  double last_step() const { return last_step_; }   ///< px of the level
  const NormalSums& sums() const { return sums_; }  ///< at point() once end_level was called

 private:
  struct System {
    Matrix8d H;
    Vector8d g;
    double objective;
  };
  System system(const NormalSums& sums, const Point& at, double variance) const;
  double residual_variance(const NormalSums& sums) const;
  void believe();                      // what the level has found out
  bool judge(const NormalSums& sums);  // true: the evaluated point is the accepted one
  void propose();

  LmProblem problem_;
  std::optional<PosePrior> belief_;  // the prior, and what coarser levels have found out
  double variance_ = 1;              // of a residual, at the accepted point
  Point point_, accepted_;
  NormalSums sums_;
  System accepted_system_;
  double focal_ = 1;
  double lambda_ = 0, nu_ = 2;
  double predicted_ = 0;  // decrease of the objective that the linear model promised
  double last_step_ = 0;
  bool has_accepted_ = false, done_ = false, singular_ = false;
};

}  // namespace iclk::internal
