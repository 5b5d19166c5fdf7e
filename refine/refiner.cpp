#include <iclk/refine/refiner.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include <iclk/align/common/each.h>
#include <iclk/align/common/options_check.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/refine/internal/verdict.h>
#include <iclk/refine/rolling_shutter.h>
#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk {
namespace {

class Stopwatch {
 public:
  double ms() const { return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start_).count(); }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

Stage& stage(RefinedAlignment& r, const char* name) {
  for (Stage& s : r.stages)
    if (s.name == name) return s;
  r.stages.push_back({name, r.T_10, 0, 0});
  return r.stages.back();
}

/// What refinement knows of one pair.
struct View {
  const Camera& camera;
  const Features& features;
  const std::vector<FeatureCheck>& checks;
};

/// Patch centre inside image 1 by the patch's half width.
bool is_visible(const View& view, size_t i, const SE3& T_10) {
  if (view.checks[i] != FeatureCheck::ok) return false;
  const PatchWarp w = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], T_10);
  const double margin = 0.5 * (ICLK_PATCH - 1);
  return w.valid && w.uv1.x() >= margin && w.uv1.y() >= margin && w.uv1.x() <= view.camera.width - 1 - margin &&
         w.uv1.y() <= view.camera.height - 1 - margin;
}

/// How far each feature moves in image 1 from pose a to pose b, px; infinite where one of them puts it behind the camera.
/// Sorted.
std::vector<double> motions(const View& view, const SE3& a, const SE3& b) {
  std::vector<double> m;
  for (size_t i = 0; i < view.checks.size(); ++i) {
    if (view.checks[i] != FeatureCheck::ok) continue;
    const PatchWarp wa = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], a);
    const PatchWarp wb = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], b);
    m.push_back(wa.valid && wb.valid ? (wb.uv1 - wa.uv1).norm() : std::numeric_limits<double>::infinity());
  }
  std::sort(m.begin(), m.end());
  return m;
}

Recolouring recolour(std::span<const AlignedFeature> features) {
  std::vector<ColourSums> patches;
  for (const AlignedFeature& f : features)
    if (f.status == FeatureStatus::aligned) patches.push_back(f.colours);
  return recolour(patches);
}

std::vector<bool> aligned_set(const std::vector<AlignedFeature>& features) {
  std::vector<bool> set;
  for (const AlignedFeature& f : features) set.push_back(f.status == FeatureStatus::aligned);
  return set;
}

/// What was found, as a camera would have it that reads all rows at once.
std::vector<AlignedFeature> straight(const View& view, const RefinedAlignment& r) {
  std::vector<AlignedFeature> features = r.features;
  if (r.turn)
    for (AlignedFeature& f : features)
      if (f.status == FeatureStatus::aligned) f.uv1 = unrolled(view.camera, *r.turn, f.uv1);
  return features;
}

/// Pose and turn of a target that is bent, if that is proven and no feature is lost by it. Returned is what the turn adds to
/// the covariance, or the doubt whether it is there.
Matrix6d unbend(const View& view, const PoseOptions& options, RefinedAlignment& r, PoseResult& pose) {
  const Stopwatch time;
  const std::optional<TurnEstimate> found = pair_turn(view.camera, view.features, r.features, pose.T_10);
  if (!found) return Matrix6d::Zero();
  if (!found->proven(view.camera)) return found->doubt(pose.T_10);
  r.turn = found->turn;
  PoseResult better = refine_pose(view.camera, view.features, straight(view, r), found->T_10, options);
  if (!usable(better.status) || better.inliers < pose.inliers) {
    r.turn.reset();
    return found->doubt(pose.T_10);
  }
  pose = std::move(better);
  Stage& pose_stage = stage(r, "pose");
  pose_stage.T_10 = pose.T_10;
  pose_stage.cost = pose.cost;
  pose_stage.ms += time.ms();
  return found->pose_share;
}

/// The verdict over the whole way; `pose` is the last round's. False if features speak against the pose that ICLK found.
bool decide(const View& view, const PoseResult& pose, const RefinerOptions& options, RefinedAlignment& r) {
  internal::Evidence e;
  for (size_t i = 0; i < view.checks.size(); ++i) {
    if (!is_visible(view, i, pose.T_10) || r.features[i].status == FeatureStatus::hidden) continue;
    ++e.visible;
    e.candidates += r.features[i].status != FeatureStatus::low_texture;
  }
  e.aligned = count_aligned(r.features);
  e.inliers = pose.inliers;
  e.rounds = r.rounds;
  e.sigma = pose.sigma;
  if (const std::vector<double> moved = motions(view, r.iclk.T_10, pose.T_10); !moved.empty())
    e.correction = moved[moved.size() / 2];
  e.pose_status = pose.status;
  e.pose_reason = pose.reason;
  internal::Verdict verdict = internal::judge(e, r.features, r.recolouring, options);
  r.visible = e.visible;
  r.aligned = e.aligned;
  r.inliers = e.inliers;
  r.sigma = e.sigma;
  r.status = verdict.status;
  r.reason = std::move(verdict.reason);
  return verdict.compatible;
}

}  // namespace

void RefinerOptions::check() const {
  feature_alignment.check();
  StructureOptions{pose, relative_sigma}.check();
  check_range("refine rounds", rounds, 1, 100);
  check_range("refine round_tolerance", round_tolerance, 0, 100);
  check_range("refine threads", threads, 0, 1024);
  check_range("refine min_inliers", min_inliers, 4, 1e6);
  check_range("refine min_inlier_share", min_inlier_share, 0, 1);
  check_range("refine max_correction", max_correction, 0, 1e4);
}

Refiner::Refiner(Aligner& aligner, const RefinerOptions& options)
    : Refiner(aligner, make_feature_aligner(aligner, options.feature_alignment), options) {}

Refiner::Refiner(Aligner& aligner, std::unique_ptr<FeatureAligner> feature_aligner, const RefinerOptions& options)
    : aligner_(aligner), feature_aligner_(std::move(feature_aligner)), options_(options) {
  options_.check();
}

Refiner::~Refiner() = default;

void Refiner::warm_up() {
  aligner_.warm_up();
  feature_aligner_->warm_up();
}

std::vector<RefinedAlignment> Refiner::align(std::span<const Pair> pairs) {
  std::vector<RefinedAlignment> results(pairs.size());
  const size_t batch = static_cast<size_t>(std::max(1, feature_aligner_->pairs_per_batch()));
  for (size_t first = 0; first < pairs.size(); first += batch) {
    const size_t n = std::min(batch, pairs.size() - first);
    refine(pairs.subspan(first, n), std::span(results).subspan(first, n));
  }
  return results;
}

void Refiner::refine(std::span<const Pair> pairs, std::span<RefinedAlignment> results) {
  const Stopwatch iclk_time;
  std::vector<Alignment> alignments = aligner_.align(pairs);
  const double iclk_ms = iclk_time.ms() / static_cast<double>(pairs.size());

  const auto view = [&](size_t i) {
    const int slot = pairs[i].reference;
    return View{aligner_.camera(slot), aligner_.features(slot), aligner_.checks(slot)};
  };
  std::vector<size_t> active;
  for (size_t i = 0; i < pairs.size(); ++i) {
    RefinedAlignment& r = results[i];
    r.iclk = std::move(alignments[i]);
    r.T_10 = r.iclk.T_10;
    r.status = r.iclk.status;
    r.reason = r.iclk.reason;
    r.inverse_depth = view(i).features.inverse_depth;
    r.stages.push_back({"iclk", r.iclk.T_10, r.iclk.cost, iclk_ms});
    if (usable(r.status)) active.push_back(i);
  }

  std::vector<SE3> T(pairs.size());  // the pose that warps the next round
  std::vector<PoseResult> poses(pairs.size());
  for (size_t i : active) T[i] = results[i].T_10;
  for (int round = 0; round < options_.rounds && !active.empty(); ++round) {
    std::vector<FeatureAlignmentTask> tasks;
    // Patches that luma has displaced do not show all of a recolouring yet: it is found again where the first one led.
    const auto wants_colours = [&](const RefinedAlignment& r) {
      return options_.feature_alignment.recolour && round + 1 < options_.rounds && (round == 0 || r.recolouring.better());
    };
    for (size_t i : active)
      tasks.push_back(
          {pairs[i].reference, static_cast<int>(i), T[i], results[i].recolouring.weights, wants_colours(results[i])});
    const Stopwatch alignment_time;
    std::vector<std::vector<AlignedFeature>> aligned = feature_aligner_->align(tasks);
    const double alignment_ms = alignment_time.ms() / static_cast<double>(tasks.size());

    std::vector<char> moves(active.size());  // each written by its own thread
    internal::for_each_of(active.size(), options_.threads, [&](size_t k) {
      const size_t i = active[k];
      RefinedAlignment& r = results[i];
      const bool same_set = round > 0 && aligned_set(r.features) == aligned_set(aligned[k]);
      r.features = std::move(aligned[k]);
      r.rounds = round + 1;
      const Recolouring found = wants_colours(r) ? recolour(r.features) : r.recolouring;
      const Stopwatch pose_time;
      const PoseResult pose = refine_pose(view(i).camera, view(i).features, r.features, T[i], options_.pose);
      Stage& alignment_stage = stage(r, "feature_alignment");
      alignment_stage.T_10 = T[i];
      alignment_stage.cost = pose.initial_cost;
      alignment_stage.ms += alignment_ms;
      Stage& pose_stage = stage(r, "pose");
      pose_stage.T_10 = pose.T_10;
      pose_stage.cost = pose.cost;
      pose_stage.ms += pose_time.ms();
      poses[i] = pose;
      // A pose on which few agree may still warp the patches better than the one before: the next round tells, or the verdict.
      if (pose.inliers < options_.pose.min_features) return;
      const std::vector<double> moved = motions(view(i), T[i], pose.T_10);
      T[i] = pose.T_10;
      const bool recoloured = found.weights != r.recolouring.weights;
      r.recolouring = found;  // what the next round sees
      moves[k] = !(moved.back() <= options_.round_tolerance) || (round > 0 && !same_set) || recoloured;
    });
    std::vector<size_t> moving;
    for (size_t k = 0; k < active.size(); ++k)
      if (moves[k]) moving.push_back(active[k]);
    active = std::move(moving);
  }

  internal::for_each_of(pairs.size(), options_.threads, [&](size_t i) {
    RefinedAlignment& r = results[i];
    if (r.rounds == 0) return;
    const Matrix6d turn_share = options_.rolling_shutter ? unbend(view(i), options_.pose, r, poses[i]) : Matrix6d::Zero();
    const bool compatible = decide(view(i), poses[i], options_, r);
    if (!usable(r.status)) {  // T_10 stays ICLK's
      if (options_.keep_unconfirmed && compatible && r.iclk.converged()) {
        r.reason = r.iclk.reason + "; not refined: " + r.reason;
        r.status = r.iclk.status;
        r.covariance = r.iclk.covariance + internal::depth_covariance(view(i).camera, view(i).features, view(i).checks, r.T_10,
                                                                      poses[i].depth_sigma, ICLK_MAP_SIGMA);
        r.turn.reset();
        r.features.clear();  // what was found is not where the pose puts it
      }
      return;
    }
    r.refined = true;
    r.T_10 = poses[i].T_10;
    r.covariance = poses[i].covariance + turn_share;
    if (!options_.structure) return;
    const Stopwatch structure_time;
    StructureResult s = refine_structure(view(i).camera, view(i).features, straight(view(i), r), r.T_10,
                                         {options_.pose, options_.relative_sigma});
    Stage& structure_stage = stage(r, "structure");
    structure_stage.T_10 = s.pose.T_10;
    structure_stage.cost = s.pose.cost;
    structure_stage.ms = structure_time.ms();
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
  });
}

}  // namespace iclk
