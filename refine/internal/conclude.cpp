#include <iclk/refine/internal/conclude.h>

#include <algorithm>
#include <optional>
#include <string>

#include <iclk/align/common/stopwatch.h>
#include <iclk/refine/internal/align_feature.h>
#include <iclk/refine/internal/plane.h>
#include <iclk/refine/internal/structure.h>
#include <iclk/refine/internal/turn.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/refine/internal/verdict.h>
#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

constexpr int kRivals = 6;  // poses that are tried besides an answer

/// Whether the patch centre is inside image 1 by half the width of a patch.
bool is_visible(const View& view, size_t i, const SE3& T_10) {
  if (view.checks[i] != FeatureCheck::ok) return false;
  const PatchWarp w = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], T_10);
  const double margin = 0.5 * (ICLK_PATCH - 1);
  return w.valid && w.uv1.x() >= margin && w.uv1.y() >= margin && w.uv1.x() <= view.camera.width - 1 - margin &&
         w.uv1.y() <= view.camera.height - 1 - margin;
}

/// The aligned features, corrected to a global shutter.
std::vector<AlignedFeature> straight(const View& view, const RefinedAlignment& r) {
  std::vector<AlignedFeature> features = r.features;
  if (r.turn)
    for (AlignedFeature& f : features)
      if (f.status == FeatureStatus::aligned) f.uv1 = unrolled(view.camera, *r.turn, f.uv1);
  return features;
}

/// The number of aligned features that one homography explains; 0 if there are too few for its eight parameters.
int explained_by_plane(const View& view, const PoseOptions& options, const RefinedAlignment& r) {
  constexpr int kEnough = 80;
  if (count_aligned(r.features) < kEnough) return 0;
  return plane_inliers(view.features, r.features, options.inlier_distance);
}

/// Corrects the pose for a turn of the target, if the turn is proven and costs no inliers. Returns its part of the covariance,
/// or that of the doubt about it.
Matrix6d unbend(const View& view, const PoseOptions& options, bool guessed, RefinedAlignment& r, PoseResult& pose) {
  const Stopwatch time;
  const std::optional<TurnEstimate> found = pair_turn(view.camera, view.features, r.features, pose.T_10);
  if (!found) return Matrix6d::Zero();
  if (!found->proven(view.camera)) return found->doubt(pose.T_10);
  r.turn = found->turn;
  PoseResult better = refine_pose(view.camera, view.features, straight(view, r), found->T_10, options);
  // Wrong depths imitate a bend. Then a plane, with fewer parameters, explains as much. With a first guess (trackers), depths
  // are trusted.
  if (!usable(better.status) || better.inliers < pose.inliers ||
      (!guessed && better.inliers <= explained_by_plane(view, options, r))) {
    r.turn.reset();
    return found->doubt(pose.T_10);
  }
  pose = std::move(better);
  record_stage(r, "pose", pose.T_10, pose.cost, time.ms());
  return found->pose_share;
}

/// The number of features that a pose projects into image 1, and of those with texture among them; the others do not constrain
/// it.
struct Shown {
  int visible = 0, candidates = 0;
};
Shown shown(const View& view, std::span<const AlignedFeature> features, const SE3& T_10) {
  Shown s;
  for (size_t i = 0; i < view.checks.size(); ++i) {
    if (!is_visible(view, i, T_10) || features[i].status == FeatureStatus::hidden) continue;
    ++s.visible;
    s.candidates += features[i].status != FeatureStatus::low_texture;
  }
  return s;
}

/// Doubts the depths if residuals are larger than any position error and one plane explains as many features. Such depths
/// belong to another frame, or are mirrored or constant.
void doubt_depths(const View& view, const PoseOptions& options, RefinedAlignment& r) {
  constexpr double kFits = 0.8, kMore = 1.02;  // shares of the aligned features, and of the inliers
  if (!(r.sigma > options.max_sigma) || r.inliers >= kFits * r.aligned) return;
  const int flat = explained_by_plane(view, options, r);
  if (flat < kMore * r.inliers) return;
  r.status = Status::diverged;
  r.reason = "the depths do not fit the images: one plane explains " + std::to_string(flat) +
             " features, but the depths explain " + std::to_string(r.inliers) + "; " + r.reason;
}

/// The verdict on alignment and refinement; `pose` is that of the last round. Returns false if the features contradict ICLK's
/// pose.
bool decide(const View& view, const PoseResult& pose, const RefinerOptions& options, bool guessed, bool half_size,
            RefinedAlignment& r) {
  Evidence e;
  e.credible = options.keep_unconfirmed && usable(r.iclk.status);
  e.guessed = guessed;
  e.half_size = half_size;
  const Shown s = shown(view, r.features, pose.T_10);
  e.visible = s.visible;
  e.candidates = s.candidates;
  e.aligned = count_aligned(r.features);
  e.inliers = pose.inliers;
  e.rounds = r.rounds;
  e.sigma = pose.sigma;
  e.correction = median_motion(view, r.iclk.T_10, pose.T_10);
  e.pose_status = pose.status;
  e.pose_reason = pose.reason;
  Verdict verdict = judge(e, r.features, r.recolouring, options);
  r.visible = e.visible;
  r.aligned = e.aligned;
  r.inliers = e.inliers;
  r.sigma = e.sigma;
  r.status = verdict.status;
  r.reason = std::move(verdict.reason);
  if (!usable(r.status)) return verdict.compatible;
  r.found_again = found_again(e, options);
  if (!guessed) doubt_depths(view, options.pose, r);
  return usable(r.status);
}

void refine_depths(const View& view, const RefinerOptions& options, const Matrix6d& turn_share, RefinedAlignment& r) {
  const Stopwatch time;
  StructureResult s =
      refine_structure(view.camera, view.features, straight(view, r), r.T_10, {options.pose, options.relative_sigma});
  record_stage(r, "structure", s.pose.T_10, s.pose.cost, time.ms());
  if (!usable(s.pose.status)) {
    r.status = s.pose.status;
    r.reason = "structure: " + s.pose.reason;
    r.covariance.setZero();
    return;
  }
  r.T_10 = s.pose.T_10;
  r.covariance = s.pose.covariance + turn_share;
  r.inverse_depth = std::move(s.inverse_depth);
  r.inverse_depth_sigma = std::move(s.inverse_depth_sigma);
  r.inliers = s.pose.inliers;
  r.sigma = s.pose.sigma;
}

}  // namespace

void conclude(const View& view, const RefinerOptions& given, const Pair& pair, PoseCandidate& c) {
  const RefinerOptions options = c.options_for(given);
  RefinedAlignment& r = *c.result;
  if (r.rounds == 0) return;
  const Matrix6d turn_share = options.rolling_shutter ? unbend(view, options.pose, !pair.search, r, c.pose) : Matrix6d::Zero();
  const bool compatible = decide(view, c.pose, options, !pair.search, c.level > 0, r);
  if (!usable(r.status)) {  // T_10 stays that of ICLK
    if (options.keep_unconfirmed && compatible && r.iclk.converged()) {
      r.reason = r.iclk.reason + "; not refined: " + r.reason;
      r.status = r.iclk.status;
      r.covariance = r.iclk.covariance +
                     depth_covariance(view.camera, view.features, view.checks, r.T_10, c.pose.depth_sigma, ICLK_MAP_SIGMA);
      r.turn.reset();
      r.features.clear();  // the found positions contradict the pose
    }
    return;
  }
  r.refined = true;
  r.T_10 = c.pose.T_10;
  r.covariance = c.pose.covariance + turn_share;
  if (options.structure) refine_depths(view, options, turn_share, r);
}

Elsewhere look_elsewhere(const View& view, const RefinerOptions& options, const Map& reference, const Pair& pair,
                         const PoseCandidate& candidate) {
  const RefinedAlignment& answer = *candidate.result;
  if (!answer.refined)
    return look_elsewhere(reference, pair, view.camera, view.features, view.checks, answer.T_10,
                          std::vector<bool>(view.checks.size()), 0, kRivals);
  const double distance = candidate.options_for(options).pose.inlier_distance;
  const std::vector<bool> agree = inliers(view.camera, view.features, answer.features, answer.T_10, distance);
  const double candidates = std::max(shown(view, answer.features, answer.T_10).candidates, 1);
  const std::vector<bool> standing = still(view.camera, view.features, answer, distance);
  const double explained =
      static_cast<double>(answer.inliers - std::count(standing.begin(), standing.end(), true)) / candidates;
  return look_elsewhere(reference, pair, view.camera, view.features, view.checks, answer.T_10, agree, explained, kRivals);
}

}  // namespace iclk::internal
