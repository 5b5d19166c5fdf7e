#pragma once
#include <span>
#include <string>
#include <vector>

#include <iclk/align/se3.h>
#include <iclk/session/pose_errors.h>

namespace iclk {

/// What a stage left of the error.
struct StageError {
  std::string stage;  ///< "initial", then Stage::name
  PoseError error;    ///< finite; where the stage did not run, that of the stage before
  bool ran = false;
};

/// One method on one variant of one pair. Every sample has a pose: who found none, or one by which no feature lies in front of
/// camera 1, is left with the start's and its error, since that is what its user has. `found` says which; where it is false the
/// pair counts in means, medians and percentiles and never as within 1 px or 3 px.
struct EvalSample {
  std::string id;
  int variant = 0;
  PoseError start;                 ///< of the first guess
  std::vector<StageError> stages;  ///< "initial" first; a method without stages has one more, named as the method
  std::string status;              ///< of iclk; of others "claimed", "refused" or "no pose"
  bool found = false;
  bool claimed = false;  ///< the method says that it succeeded; iclk: Status::converged
  double nees = 0;       ///< normalised_error() by the method's own covariance; NaN without one
  double ms = 0;

  const PoseError& final() const { return stages.back().error; }
};

struct Spread3 {
  double mean = 0, median = 0, p95 = 0;
};

/// A row of the table: one stage over all samples.
struct StageRow {
  std::string stage;
  int pairs = 0, ran = 0;
  Spread3 e_pixel, e_transl, e_rot;       ///< px, unit of the depth, rad
  double within_1px = 0, within_3px = 0;  ///< shares of all samples
};

/// What a method says of itself against what is true.
struct ClaimRow {
  int pairs = 0, claimed = 0;
  int wrong = 0;            ///< of these, more than 3 px off the truth
  double e_pixel = 0;       ///< median of the claimed, px; NaN without any
  int with_covariance = 0;  ///< claimed samples that have one; the rest is of these
  double nees = 0;          ///< mean; 6 where the covariance is right, larger where it is too small
  double nees_median = 0;   ///< 5.35 where it is right: one wrong claim spoils a mean
  double inside_95 = 0;     ///< share with an error inside the 95 % ellipsoid (nees below 12.59)
  double ms = 0;            ///< median
};

/// Linear between order statistics, as numpy.percentile: x[(n - 1) p / 100] of the sorted values. NaN for none.
double percentile(std::vector<double> values, double p);
/// NaN for none.
Spread3 spread3(const std::vector<double>& values);

/// xi^T C^-1 xi with xi = Log(mean^-1 truth): the twist of `covariance`, truth = mean Exp(xi), [rho, phi]. NaN unless the
/// covariance is finite and positive definite.
double normalised_error(const SE3& mean, const Matrix6d& covariance, const SE3& truth);

/// One row a stage, in the order of the first sample, "initial" included.
std::vector<StageRow> stage_rows(std::span<const EvalSample> samples);
ClaimRow claim_row(std::span<const EvalSample> samples);

/// Success against the start's error: bins of equally many samples.
struct BasinBin {
  double from = 0, to = 0, centre = 0;  ///< of the start's error; centre: the median
  int pairs = 0;
  double success = 0;  ///< share of these that end within `limit` px
};
/// `of`: which of the start's errors. At most `bins`, of at least five samples each if there are as many.
std::vector<BasinBin> basin(std::span<const EvalSample> samples, double PoseError::*of, int bins, double limit);

}  // namespace iclk
