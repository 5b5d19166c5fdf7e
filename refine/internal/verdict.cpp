#include <iclk/refine/internal/verdict.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

namespace {

constexpr double kLeastSigma = 0.3;  // px, of positions where grey values differ

/// Limits for poses that features find again; ICLK_AGAIN_... at full size.
struct AgainLimits {
  double correction, sigma, share;
  int min_inliers;  ///< times RefinerOptions::min_inliers
};
// Under severe changes, right poses of models are up to 2 px off. Wrong depths on which features of half the size agree leave
// residuals of 0.52 px and more. If a fifth of the features agrees, another season may have moved them all. The pose of 10 to
// 19 features is no more precise than the model's.
constexpr AgainLimits kHalfSize{2, 0.5, 0.25, 2};
constexpr AgainLimits kFullSize{ICLK_REFUTED_CORRECTION, ICLK_AGAIN_SIGMA, ICLK_AGAIN_SHARE, 1};

}  // namespace

bool found_again(const Evidence& e, const RefinerOptions& options) {
  const AgainLimits& limits = e.half_size ? kHalfSize : kFullSize;
  return e.credible && !e.guessed && e.correction <= limits.correction && e.sigma <= limits.sigma &&
         e.inliers >= std::max<double>(limits.min_inliers * options.min_inliers, limits.share * e.candidates) &&
         e.inliers >= ICLK_AGAIN_AGREEMENT * e.aligned;
}

Verdict judge(const Evidence& e, std::span<const AlignedFeature> features, const Recolouring& recolouring,
              const RefinerOptions& options) {
  std::ostringstream why;
  const auto end = [&](Status status, bool compatible = true) { return Verdict{status, why.str(), compatible}; };
  if (e.candidates < options.min_inliers && e.inliers < options.min_inliers) {
    why << e.candidates << " features with texture are inside the target, " << options.min_inliers << " needed; "
        << summary(features);
    return end(Status::too_few_features);
  }
  const bool clear = e.inliers >= ICLK_CLEAR_AGREEMENT * e.aligned;
  const double share = clear ? std::min(options.min_clear_share, options.min_inlier_share) : options.min_inlier_share;
  const int needed = std::max(options.min_inliers, static_cast<int>(std::ceil(share * e.candidates)));
  if (e.inliers < needed && !found_again(e, options)) {
    why << "the features do not confirm the pose: " << e.inliers << " of " << e.candidates
        << " with texture inside the target agree on it, " << needed << " needed; " << summary(features);
    // Enough features were found to confirm the pose, but they do not, or those that agree have another pose. With a first
    // guess, the tracker decides.
    const bool disagree = e.aligned >= needed && e.inliers < ICLK_REFUTED_SHARE * e.aligned;
    const bool elsewhere = e.inliers >= options.min_inliers && !(e.correction <= ICLK_REFUTED_CORRECTION);
    return end(Status::diverged, e.guessed || !(disagree || elsewhere));
  }
  if (!usable(e.pose_status)) {
    why << "pose refinement: " << e.pose_reason;
    return end(e.pose_status);
  }
  if (!(e.correction <= options.max_correction)) {
    why << "refinement moved the features by " << e.correction << " px (median), more than the " << options.max_correction
        << " px allowed";
    return end(Status::diverged, false);
  }
  why << e.aligned << " of " << e.visible << " visible features aligned, " << e.inliers << " agree on the pose, residual sigma "
      << e.sigma << " px, " << e.rounds << (e.rounds == 1 ? " round" : " rounds");
  if (const GreyWeights& w = recolouring.weights; recolouring.better())
    why << ", target converted to grey as " << w[0] << " R " << std::showpos << w[1] << " G " << w[2] << " B" << std::noshowpos;
  if (e.pose_status == Status::max_iterations) why << "; " << e.pose_reason;
  return end(e.pose_status);
}

void judge_second_look(RefinedAlignment& r) {
  constexpr double kOfAligned = 0.8, kOfVisible = 0.2;  // share of the features that agree
  if (!r.converged() || !r.refined || r.found_again) return;
  if (r.inliers >= kOfAligned * r.aligned && r.inliers >= kOfVisible * r.visible) return;
  r.status = Status::diverged;
  r.covariance.setZero();
  r.reason =
      "too few features agree for a second look, which needs 80 % of the aligned and 20 % of the visible ones: " + r.reason;
}

bool weakly_confirmed(const RefinedAlignment& r) {
  return r.converged() && r.refined && 2 * r.inliers < r.visible && r.sigma >= kLeastSigma;
}

RefinerOptions by_lines(RefinerOptions options) {
  options.keep_unconfirmed = options.rolling_shutter = options.structure = false;
  options.min_inliers = 40;
  options.min_inlier_share = options.min_clear_share = 0.5;
  return options;
}

bool confirmed_by_lines(const RefinedAlignment& r) {
  constexpr double kMostSigma = 1;  // px, of the positions
  return r.converged() && r.refined && r.sigma >= kLeastSigma && r.sigma <= kMostSigma &&
         3 * static_cast<size_t>(r.inliers) >= r.features.size() && r.iclk.repeats < ICLK_MATCH_REPEATS;
}

std::string inliers_text(int inliers, int used, const PoseOptions& options) {
  std::ostringstream text;
  text << inliers << " of " << used << " features within " << options.inlier_distance << " px";
  return text.str();
}

}  // namespace iclk::internal
