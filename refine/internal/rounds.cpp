#include <iclk/refine/internal/rounds.h>

#include <algorithm>
#include <vector>

#include <iclk/align/common/each.h>
#include <iclk/align/common/stopwatch.h>

namespace iclk::internal {
namespace {

std::vector<bool> aligned_set(const std::vector<AlignedFeature>& features) {
  std::vector<bool> set;
  for (const AlignedFeature& f : features) set.push_back(f.status == FeatureStatus::aligned);
  return set;
}

/// Patches that luma has displaced do not show the whole recolouring, so it is estimated again after the first one.
bool wants_colours(const RefinerOptions& options, const PoseCandidate& c, int round) {
  const RefinedAlignment& r = *c.result;
  return options.feature_alignment.recolour && c.level == 0 && round + 1 < options.rounds &&
         (round == 0 || r.recolouring.better());
}

/// Computes the pose from the features of this round. Returns false if a further round would give the same.
bool take_step(const View& view, const RefinerOptions& options, int round, AlignedFeatures&& found, double alignment_ms,
               PoseCandidate& c) {
  RefinedAlignment& r = *c.result;
  const bool same_set = round > 0 && aligned_set(r.features) == aligned_set(found.features);
  const Recolouring recolouring = wants_colours(options, c, round) ? recolour(found.colours) : r.recolouring;
  r.features = std::move(found.features);
  r.rounds = round + 1;
  const Stopwatch time;
  c.pose = refine_pose(view.camera, view.features, r.features, c.T_10, c.options_for(options).pose);
  record_stage(r, "feature_alignment", c.T_10, c.pose.initial_cost, alignment_ms);
  record_stage(r, "pose", c.pose.T_10, c.pose.cost, time.ms());
  // A pose with few inliers may still warp the patches better than the previous one; the next round or the verdict decides.
  if (c.pose.inliers < std::max(options.pose.min_features, c.least)) return false;
  const std::vector<double> moved = motions(view, c.T_10, c.pose.T_10);
  c.T_10 = c.pose.T_10;
  const bool recoloured = recolouring.weights != r.recolouring.weights;
  r.recolouring = recolouring;  // for the next round
  return !(moved.back() <= options.round_tolerance) || (round > 0 && !same_set) || recoloured;
}

std::vector<FeatureAlignmentTask> tasks_of(const RefinerOptions& options, std::span<const Pair> pairs,
                                           std::span<PoseCandidate* const> candidates, int round) {
  std::vector<FeatureAlignmentTask> tasks;
  for (const PoseCandidate* c : candidates)
    tasks.push_back({pairs[c->pair].reference, static_cast<int>(c->pair), c->T_10, c->result->recolouring.weights,
                     wants_colours(options, *c, round), c->level});
  return tasks;
}

}  // namespace

RefinerOptions PoseCandidate::options_for(RefinerOptions options) const {
  options.pose.inlier_distance *= 1 << level;
  return options;
}

View view_of(const Aligner& aligner, int slot) { return {aligner.camera(slot), aligner.features(slot), aligner.checks(slot)}; }

void record_stage(RefinedAlignment& r, const char* name, const SE3& T_10, double cost, double ms) {
  auto stage = std::find_if(r.stages.begin(), r.stages.end(), [&](const Stage& s) { return s.name == name; });
  if (stage == r.stages.end()) stage = r.stages.insert(stage, {name, {}, 0, 0});
  stage->T_10 = T_10;
  stage->cost = cost;
  stage->ms += ms;
}

void run_rounds(const Aligner& aligner, FeatureAligner& feature_aligner, const RefinerOptions& options,
                std::span<const Pair> pairs, std::span<PoseCandidate> candidates) {
  std::vector<PoseCandidate*> active;
  for (PoseCandidate& c : candidates) active.push_back(&c);
  for (int round = 0; round < options.rounds && !active.empty(); ++round) {
    const Stopwatch time;
    std::vector<AlignedFeatures> found = feature_aligner.align(tasks_of(options, pairs, active, round));
    const double ms = time.ms() / static_cast<double>(active.size());
    std::vector<char> moves(active.size());  // each one is written by one thread
    for_each_of(active.size(), options.threads, [&](size_t k) {
      const View view = view_of(aligner, pairs[active[k]->pair].reference);
      moves[k] = take_step(view, options, round, std::move(found[k]), ms, *active[k]);
    });
    std::vector<PoseCandidate*> moving;
    for (size_t k = 0; k < active.size(); ++k)
      if (moves[k]) moving.push_back(active[k]);
    active = std::move(moving);
  }
}

}  // namespace iclk::internal
