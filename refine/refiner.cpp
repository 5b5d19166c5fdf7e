#include <iclk/refine/refiner.h>

#include <algorithm>
#include <cmath>
#include <iterator>

#include <iclk/align/common/each.h>
#include <iclk/align/common/options_check.h>
#include <iclk/align/common/stopwatch.h>
#include <iclk/refine/internal/plane.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/refine/internal/rivals.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/refine/internal/verdict.h>
#include <iclk/refine/rolling_shutter.h>
#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk {
namespace {

using internal::Stopwatch;

constexpr int kRivals = 6;            // poses that are tried beside an answer
constexpr double kWorthARound = 0.2;  // share of the answer's inliers: with fewer a pose gets no further round

Stage& stage(RefinedAlignment& r, const char* name) {
  for (Stage& s : r.stages)
    if (s.name == name) return s;
  r.stages.push_back({name, r.T_10, 0, 0});
  return r.stages.back();
}

using internal::View;

View view_of(const Aligner& aligner, int slot) { return {aligner.camera(slot), aligner.features(slot), aligner.checks(slot)}; }

/// Patch centre inside image 1 by the patch's half width.
bool is_visible(const View& view, size_t i, const SE3& T_10) {
  if (view.checks[i] != FeatureCheck::ok) return false;
  const PatchWarp w = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], T_10);
  const double margin = 0.5 * (ICLK_PATCH - 1);
  return w.valid && w.uv1.x() >= margin && w.uv1.y() >= margin && w.uv1.x() <= view.camera.width - 1 - margin &&
         w.uv1.y() <= view.camera.height - 1 - margin;
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

/// Aligned features that one homography explains; 0 where they are few, which fit its eight parameters by chance.
int explained_by_plane(const View& view, const PoseOptions& options, const RefinedAlignment& r) {
  constexpr int kEnough = 80;
  if (count_aligned(r.features) < kEnough) return 0;
  return internal::plane_inliers(view.features, r.features, options.inlier_distance);
}

/// Pose and turn of a target that is bent, if that is proven and no feature is lost by it. Returned is what the turn adds to
/// the covariance, or the doubt whether it is there.
Matrix6d unbend(const View& view, const PoseOptions& options, bool guessed, RefinedAlignment& r, PoseResult& pose) {
  const Stopwatch time;
  const std::optional<TurnEstimate> found = pair_turn(view.camera, view.features, r.features, pose.T_10);
  if (!found) return Matrix6d::Zero();
  if (!found->proven(view.camera)) return found->doubt(pose.T_10);
  r.turn = found->turn;
  PoseResult better = refine_pose(view.camera, view.features, straight(view, r), found->T_10, options);
  // Wrong depths bend a target too. Then one plane, of fewer parameters, explains as much. A tracker knows its depths.
  if (!usable(better.status) || better.inliers < pose.inliers ||
      (!guessed && better.inliers <= explained_by_plane(view, options, r))) {
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

/// Features that a pose puts inside image 1, and of these those with texture: the rest says nothing about it.
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

/// Where residuals are larger than positions are ever off by, and one plane explains as many features as the depths do, the
/// depths say nothing: they are another frame's, mirrored, constant.
void doubt_depths(const View& view, const PoseOptions& options, RefinedAlignment& r) {
  constexpr double kFits = 0.8, kMore = 1.02;  // shares of the aligned features, and of the inliers
  if (!(r.sigma > options.max_sigma) || r.inliers >= kFits * r.aligned) return;
  const int flat = explained_by_plane(view, options, r);
  if (flat < kMore * r.inliers) return;
  r.status = Status::diverged;
  r.reason = "the depths do not fit the images: one plane explains " + std::to_string(flat) + " features, they explain " +
             std::to_string(r.inliers) + "; " + r.reason;
}

/// The verdict over the whole way; `pose` is the last round's. False if features speak against the pose that ICLK found.
bool decide(const View& view, const PoseResult& pose, const RefinerOptions& options, bool guessed, RefinedAlignment& r) {
  internal::Evidence e;
  e.guessed = guessed;
  const Shown s = shown(view, r.features, pose.T_10);
  e.visible = s.visible;
  e.candidates = s.candidates;
  e.aligned = count_aligned(r.features);
  e.inliers = pose.inliers;
  e.rounds = r.rounds;
  e.sigma = pose.sigma;
  if (const std::vector<double> moved = internal::motions(view, r.iclk.T_10, pose.T_10); !moved.empty())
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
  if (!usable(r.status)) return verdict.compatible;
  if (!guessed) doubt_depths(view, options.pose, r);
  return usable(r.status);
}

internal::Elsewhere look(const View& view, const RefinerOptions& options, const Map& reference, const Pair& pair,
                         const RefinedAlignment& answer) {
  if (!answer.refined)
    return internal::look_elsewhere(reference, pair, view.camera, view.features, view.checks, answer.T_10,
                                    std::vector<bool>(view.checks.size()), 0, kRivals);
  const std::vector<bool> agree =
      internal::inliers(view.camera, view.features, answer.features, answer.T_10, options.pose.inlier_distance);
  const double candidates = std::max(shown(view, answer.features, answer.T_10).candidates, 1);
  const auto still = internal::still(view.camera, view.features, answer, options.pose.inlier_distance);
  const double explained = static_cast<double>(answer.inliers - std::count(still.begin(), still.end(), true)) / candidates;
  return internal::look_elsewhere(reference, pair, view.camera, view.features, view.checks, answer.T_10, agree, explained,
                                  kRivals);
}

void refine_depths(const View& view, const RefinerOptions& options, const Matrix6d& turn_share, RefinedAlignment& r) {
  const Stopwatch time;
  StructureResult s =
      refine_structure(view.camera, view.features, straight(view, r), r.T_10, {options.pose, options.relative_sigma});
  Stage& structure_stage = stage(r, "structure");
  structure_stage.T_10 = s.pose.T_10;
  structure_stage.cost = s.pose.cost;
  structure_stage.ms = time.ms();
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

void RefinerOptions::check() const {
  feature_alignment.check();
  StructureOptions{pose, relative_sigma}.check();
  check_range("refine rounds", rounds, 1, 100);
  check_range("refine round_tolerance", round_tolerance, 0, 100);
  check_range("refine threads", threads, 0, 1024);
  check_range("refine min_inliers", min_inliers, 4, 1e6);
  check_range("refine min_inlier_share", min_inlier_share, 0, 1);
  check_range("refine max_correction", max_correction, 0, 1e4);
  check_range("refine max_rival_share", max_rival_share, 0, 1);
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
  std::vector<Candidate> candidates;
  for (size_t i = 0; i < pairs.size(); ++i) {
    RefinedAlignment& r = results[i];
    r.iclk = std::move(alignments[i]);
    r.T_10 = r.iclk.T_10;
    r.status = r.iclk.status;
    r.reason = r.iclk.reason;
    r.inverse_depth = aligner_.features(pairs[i].reference).inverse_depth;
    r.stages.push_back({"iclk", r.iclk.T_10, r.iclk.cost, iclk_ms});
    if (usable(r.status)) candidates.push_back({i, &r, r.T_10, {}});
  }
  run_rounds(pairs, candidates);
  internal::for_each_of(candidates.size(), options_.threads,
                        [&](size_t k) { conclude(pairs[candidates[k].pair], candidates[k]); });
  question(pairs, candidates);
}

void Refiner::run_rounds(std::span<const Pair> pairs, std::span<Candidate> candidates) {
  const auto view = [&](const Candidate& c) { return view_of(aligner_, pairs[c.pair].reference); };
  std::vector<Candidate*> active;
  for (Candidate& c : candidates) active.push_back(&c);
  for (int round = 0; round < options_.rounds && !active.empty(); ++round) {
    // Patches that luma has displaced do not show all of a recolouring yet: it is found again where the first one led.
    const auto wants_colours = [&](const RefinedAlignment& r) {
      return options_.feature_alignment.recolour && round + 1 < options_.rounds && (round == 0 || r.recolouring.better());
    };
    std::vector<FeatureAlignmentTask> tasks;
    for (const Candidate* c : active)
      tasks.push_back({pairs[c->pair].reference, static_cast<int>(c->pair), c->T_10, c->result->recolouring.weights,
                       wants_colours(*c->result)});
    const Stopwatch alignment_time;
    std::vector<std::vector<AlignedFeature>> aligned = feature_aligner_->align(tasks);
    const double alignment_ms = alignment_time.ms() / static_cast<double>(tasks.size());

    std::vector<char> moves(active.size());  // each written by its own thread
    internal::for_each_of(active.size(), options_.threads, [&](size_t k) {
      Candidate& c = *active[k];
      RefinedAlignment& r = *c.result;
      const bool same_set = round > 0 && aligned_set(r.features) == aligned_set(aligned[k]);
      r.features = std::move(aligned[k]);
      r.rounds = round + 1;
      const Recolouring found = wants_colours(r) ? recolour(r.features) : r.recolouring;
      const Stopwatch pose_time;
      const PoseResult pose = refine_pose(view(c).camera, view(c).features, r.features, c.T_10, options_.pose);
      Stage& alignment_stage = stage(r, "feature_alignment");
      alignment_stage.T_10 = c.T_10;
      alignment_stage.cost = pose.initial_cost;
      alignment_stage.ms += alignment_ms;
      Stage& pose_stage = stage(r, "pose");
      pose_stage.T_10 = pose.T_10;
      pose_stage.cost = pose.cost;
      pose_stage.ms += pose_time.ms();
      c.pose = pose;
      // A pose on which few agree may still warp the patches better than the one before: the next round tells, or the verdict.
      if (pose.inliers < std::max(options_.pose.min_features, c.least)) return;
      const std::vector<double> moved = internal::motions(view(c), c.T_10, pose.T_10);
      c.T_10 = pose.T_10;
      const bool recoloured = found.weights != r.recolouring.weights;
      r.recolouring = found;  // what the next round sees
      moves[k] = !(moved.back() <= options_.round_tolerance) || (round > 0 && !same_set) || recoloured;
    });
    std::vector<Candidate*> moving;
    for (size_t k = 0; k < active.size(); ++k)
      if (moves[k]) moving.push_back(active[k]);
    active = std::move(moving);
  }
}

void Refiner::conclude(const Pair& pair, Candidate& c) const {
  const View view = view_of(aligner_, pair.reference);
  RefinedAlignment& r = *c.result;
  if (r.rounds == 0) return;
  const Matrix6d turn_share =
      options_.rolling_shutter ? unbend(view, options_.pose, !pair.search, r, c.pose) : Matrix6d::Zero();
  const bool compatible = decide(view, c.pose, options_, !pair.search, r);
  if (!usable(r.status)) {  // T_10 stays ICLK's
    if (options_.keep_unconfirmed && compatible && r.iclk.converged()) {
      r.reason = r.iclk.reason + "; not refined: " + r.reason;
      r.status = r.iclk.status;
      r.covariance = r.iclk.covariance + internal::depth_covariance(view.camera, view.features, view.checks, r.T_10,
                                                                    c.pose.depth_sigma, ICLK_MAP_SIGMA);
      r.turn.reset();
      r.features.clear();  // what was found is not where the pose puts it
    }
    return;
  }
  r.refined = true;
  r.T_10 = c.pose.T_10;
  r.covariance = c.pose.covariance + turn_share;
  if (options_.structure) refine_depths(view, options_, turn_share, r);
}

void Refiner::question(std::span<const Pair> pairs, std::span<const Candidate> all) {
  const Stopwatch time;
  const auto view = [&](const Candidate& c) { return view_of(aligner_, pairs[c.pair].reference); };
  const auto is_claim = [&](const Candidate& c) {  // a guess decides
    return c.result->converged() && !pairs[c.pair].prior && pairs[c.pair].search;
  };
  std::vector<Candidate> answers;
  std::copy_if(all.begin(), all.end(), std::back_inserter(answers), is_claim);
  std::vector<internal::Elsewhere> elsewhere(answers.size());
  internal::for_each_of(answers.size(), options_.threads, [&](size_t k) {
    const Pair& pair = pairs[answers[k].pair];
    elsewhere[k] = look(view(answers[k]), options_, aligner_.grey(pair.reference), pair, *answers[k].result);
  });
  std::vector<std::vector<RefinedAlignment>> found(answers.size());
  std::vector<Candidate> rivals;
  for (size_t k = 0; k < answers.size(); ++k) {
    found[k].resize(elsewhere[k].poses.size());
    for (size_t j = 0; j < found[k].size(); ++j) {
      found[k][j].iclk.T_10 = found[k][j].T_10 = elsewhere[k].poses[j];
      found[k][j].inverse_depth = answers[k].result->inverse_depth;
      const int least = static_cast<int>(kWorthARound * answers[k].result->inliers);
      rivals.push_back({answers[k].pair, &found[k][j], elsewhere[k].poses[j], {}, least});
    }
  }
  run_rounds(pairs, rivals);
  for (Candidate& rival : rivals) {
    conclude(pairs[rival.pair], rival);
    if (!rival.result->refined) rival.result->T_10 = rival.pose.T_10;  // weighed all the same
  }
  for (size_t k = 0; k < answers.size(); ++k) {
    RefinedAlignment& answer = *answers[k].result;
    answer.refined ? internal::weigh(view(answers[k]), options_, found[k], answer)
                   : internal::prefer_confirmed(found[k], answer);
    if (answer.converged()) internal::doubt_stillness(view(answers[k]), options_, elsewhere[k].seen, answer);
  }
  const double ms = time.ms() / static_cast<double>(std::max<size_t>(answers.size(), 1));
  for (const Candidate& c : answers) c.result->stages.push_back({"rivals", c.result->T_10, c.result->stages.back().cost, ms});
}

}  // namespace iclk
