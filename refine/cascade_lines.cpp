// The looks of a Cascade at lines.
#include <string>
#include <utility>

#include <iclk/align/common/stopwatch.h>
#include <iclk/align/search/line_patches.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/line_aligner.h>
#include <iclk/refine/internal/rounds.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/refine/internal/verdict.h>

namespace iclk {
namespace {

constexpr double kForMean = 3;      // px, median motion: farther poses are not averaged
constexpr double kMore = 1.5;       // times as many features as confirm a pose in grey values, to replace or doubt it
constexpr double kClearlyMore = 2;  // the same to correct it, if they do not confirm the new one
constexpr double kContradicts = 1;  // px: a claim moves no farther, because its covariance does not know of the correction
constexpr double kAlike = 3;        // the factor of the covariance, because overlapping patches have similar errors
constexpr double kShift = 0.3;      // px: the sigma of a shift of all lines, such as by shadows

/// Takes back a claim.
void refuse(RefinedAlignment& answer) {
  answer.status = Status::diverged;
  answer.refined = false;
  answer.covariance.setZero();
  answer.reason = "lines contradict the pose: " + answer.reason;
}

}  // namespace

std::optional<internal::LinePose> Cascade::pose_by_lines(const Pair& pair, size_t step, internal::PairLines& lines,
                                                         const RefinedAlignment& answer) const {
  const Aligner& aligner = *running_[step].aligner;
  const std::vector<internal::LineRound> rounds = internal::line_rounds(aligner.camera(pair.reference));
  const auto near = [&](const SE3& start, std::span<const internal::LineRound> from) {
    return internal::match_line_patches(keyframes_[static_cast<size_t>(pair.reference)].reference,
                                        aligner.checks(pair.reference), lines, start, from, steps_[step].refiner->threads);
  };
  std::optional<internal::LinePose> best = near(answer.T_10, std::span(rounds).subspan(2));
  if (pair.found && !answer.converged()) {
    const auto from_start = near(pair.T_10, rounds);
    if (from_start && (!best || from_start->share() > best->share())) best = from_start;
  }
  return best;
}

Matrix6d Cascade::shift_of_lines(const Pair& pair, size_t step, const SE3& T_10) const {
  const Aligner& aligner = *running_[step].aligner;
  return internal::shift_covariance(aligner.camera(pair.reference), aligner.features(pair.reference),
                                    aligner.checks(pair.reference), T_10, kShift);
}

std::optional<RefinedAlignment> Cascade::refine_by_lines(const Pair& pair, size_t step, internal::PairLines& lines,
                                                         const SE3& T_10, const RefinedAlignment& answer) {
  if (!pair.search || pair.prior) return {};
  Aligner& aligner = *running_[step].aligner;
  prepare(step, pair.reference);
  const RefinerOptions options = internal::by_lines(*steps_[step].refiner);
  Refiner refiner(aligner,
                  internal::make_line_aligner(keyframes_[static_cast<size_t>(pair.reference)].reference,
                                              aligner.checks(pair.reference), lines.at(1), options.threads),
                  options);
  Alignment known = answer.iclk;
  known.T_10 = T_10;
  known.status = Status::converged;
  RefinedAlignment confirmed = refiner.refine(pair, std::move(known));
  if (!internal::confirmed_by_lines(confirmed)) return {};
  confirmed.by_lines = true;
  confirmed.covariance *= kAlike;
  confirmed.covariance += shift_of_lines(pair, step, confirmed.T_10);
  for (AlignedFeature& f : confirmed.features)
    if (f.status == FeatureStatus::aligned) f.covariance = confirmed.sigma * confirmed.sigma * Eigen::Matrix2d::Identity();
  confirmed.reason += "; by lines";
  confirmed.model = steps_[step].model;
  confirmed.attempts = answer.attempts;
  confirmed.attempts.push_back({confirmed.model + ", lines", confirmed.status, confirmed.reason});
  return confirmed;
}

void Cascade::look_at_lines(const Pair& pair, const Opinion& by_contrast, RefinedAlignment& answer, bool last) {
  if (answer.status == Status::ambiguous || answer.by_lines) return;
  const internal::Stopwatch time;
  std::optional<internal::LinePose> by_lines;
  std::optional<RefinedAlignment> confirmed;
  if (internal::match_layout(running_[by_contrast.step].aligner->camera(pair.reference)).enabled) {
    internal::PairLines lines(keyframes_[static_cast<size_t>(pair.reference)].reference, pair);
    by_lines = pose_by_lines(pair, by_contrast.step, lines, answer);
    if (by_lines) confirmed = refine_by_lines(pair, by_contrast.step, lines, by_lines->T_10, answer);
  }
  times_.align += time.ms();
  if (confirmed && confirmed->inliers >= (answer.refined ? kMore * answer.inliers : 0))
    answer = std::move(*confirmed);
  else if (last)
    correct(pair, by_contrast, by_lines, answer);
}

void Cascade::correct(const Pair& pair, const Opinion& by_contrast, const std::optional<internal::LinePose>& by_lines,
                      RefinedAlignment& answer) {
  constexpr double kNearby = 3, kShareNearby = 0.25, kShare = 0.35;  // px; of the patches, which must agree
  const internal::Stopwatch time;
  const SE3 given = answer.T_10;
  const auto moved = [&](const SE3& T_10) {
    return internal::median_motion(internal::view_of(*running_[by_contrast.step].aligner, pair.reference), T_10, given);
  };
  const double by = by_lines ? moved(by_lines->T_10) : 0, apart = moved(by_contrast.T_10);
  const auto outvoted = [&](double times) {
    return !answer.refined || (!answer.blur && by_lines->agreeing >= times * answer.inliers);
  };
  const bool contradicts = answer.converged() && by > kContradicts;
  if (by_lines && outvoted(contradicts ? kMore : kClearlyMore) &&
      by_lines->share() >= (by <= kNearby ? kShareNearby : kShare)) {
    const bool corrects = outvoted(kClearlyMore);
    if (contradicts) refuse(answer);
    if (corrects) answer.T_10 = by_lines->T_10;
    if (corrects && answer.converged()) answer.covariance += shift_of_lines(pair, by_contrast.step, answer.T_10);
    answer.reason += std::string("; ") + (corrects ? "" : "another ") + "pose by lines, on which " +
                     std::to_string(by_lines->agreeing) + " of " + std::to_string(by_lines->compared) + " patches agree";
  } else if (!answer.refined && apart > 0 && apart <= kForMean) {
    answer.T_10 = given * SE3::exp(0.5 * (given.inverse() * by_contrast.T_10).log());
    answer.reason += "; mean with the pose by local contrast";
  } else {
    return;
  }
  internal::record_stage(answer, "correction", answer.T_10, answer.stages.back().cost, time.ms());
}

}  // namespace iclk
