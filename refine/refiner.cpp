#include <iclk/refine/refiner.h>

#include <algorithm>

#include <iclk/align/common/each.h>
#include <iclk/align/common/options_check.h>
#include <iclk/align/common/stopwatch.h>
#include <iclk/refine/internal/conclude.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/refine/internal/structure.h>

namespace iclk {
namespace {

using internal::PoseCandidate;
using internal::Stopwatch;

constexpr double kWorthARound = 0.2;  // share of the answer's inliers; a pose with fewer gets no further round
constexpr int kHalfSize = 1;          // FeatureAlignmentTask::level

/// An answer, and the poses that may rival it.
struct Contested {
  PoseCandidate answer;
  internal::Elsewhere elsewhere;
  std::vector<RefinedAlignment> rivals;
};

/// Converged answers of pairs without a first guess.
std::vector<Contested> contested(std::span<const Pair> pairs, std::span<const PoseCandidate> candidates) {
  std::vector<Contested> found;
  for (const PoseCandidate& c : candidates)
    if (c.result->converged() && !pairs[c.pair].prior && pairs[c.pair].search) found.push_back({c, {}, {}});
  return found;
}

/// Collects the rivals of all answers, so that their rounds run together.
std::vector<PoseCandidate> rivals_of(std::vector<Contested>& all) {
  std::vector<PoseCandidate> rivals;
  for (Contested& c : all) {
    const RefinedAlignment& answer = *c.answer.result;
    c.rivals.resize(c.elsewhere.poses.size());
    for (size_t j = 0; j < c.rivals.size(); ++j) {
      const SE3& T_10 = c.elsewhere.poses[j];
      c.rivals[j].iclk.T_10 = c.rivals[j].T_10 = T_10;
      c.rivals[j].inverse_depth = answer.inverse_depth;
      rivals.push_back(
          {c.answer.pair, &c.rivals[j], T_10, {}, static_cast<int>(kWorthARound * answer.inliers), c.answer.level});
    }
  }
  return rivals;
}

/// The state before the refinement; it keeps the times of the stages.
RefinedAlignment begun_again(const RefinedAlignment& given) {
  RefinedAlignment r;
  r.iclk = given.iclk;
  r.T_10 = given.iclk.T_10;
  r.recolouring = given.recolouring;
  r.inverse_depth = given.inverse_depth;
  r.stages = given.stages;
  return r;
}

/// Compares an answer with its rivals.
void settle(const internal::View& view, const RefinerOptions& given, Contested& c) {
  const RefinerOptions options = c.answer.options_for(given);
  RefinedAlignment& answer = *c.answer.result;
  answer.refined ? internal::weigh(view, options, c.rivals, answer) : internal::prefer_confirmed(c.rivals, answer);
  if (answer.converged()) internal::doubt_stillness(view, options, c.elsewhere.seen, answer);
}

}  // namespace

void RefinerOptions::check() const {
  feature_alignment.check();
  internal::StructureOptions{pose, relative_sigma}.check();
  check_range("refine rounds", rounds, 1, 100);
  check_range("refine round_tolerance", round_tolerance, 0, 100);
  check_range("refine threads", threads, 0, 1024);
  check_range("refine min_inliers", min_inliers, 4, 1e6);
  check_range("refine min_inlier_share", min_inlier_share, 0, 1);
  check_range("refine min_clear_share", min_clear_share, 0, 1);
  check_range("refine max_correction", max_correction, 0, 1e4);
  check_range("refine max_rival_share", max_rival_share, 0, 1);
}

Refiner::Refiner(Aligner& aligner, const RefinerOptions& options)
    : Refiner(aligner, internal::make_feature_aligner(aligner, options.feature_alignment), options) {}

Refiner::Refiner(Aligner& aligner, std::unique_ptr<internal::FeatureAligner> feature_aligner, const RefinerOptions& options)
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
    const Stopwatch time;
    std::vector<Alignment> alignments = aligner_.align(pairs.subspan(first, n));
    const double ms = time.ms() / static_cast<double>(n);
    refine(pairs.subspan(first, n), std::move(alignments), ms, std::span(results).subspan(first, n));
  }
  return results;
}

RefinedAlignment Refiner::refine(const Pair& pair, Alignment known) {
  RefinedAlignment result;
  refine({&pair, 1}, {std::move(known)}, 0, {&result, 1});
  return result;
}

void Refiner::refine(std::span<const Pair> pairs, std::vector<Alignment> alignments, double iclk_ms,
                     std::span<RefinedAlignment> results) {
  std::vector<PoseCandidate> candidates;
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
  internal::run_rounds(aligner_, *feature_aligner_, options_, pairs, candidates);
  internal::for_each_of(candidates.size(), options_.threads, [&](size_t k) { conclude(pairs, candidates[k]); });
  look_at_half_size(pairs, candidates);
  question(pairs, candidates);
}

void Refiner::look_at_half_size(std::span<const Pair> pairs, std::span<PoseCandidate> candidates) {
  if (!options_.keep_unconfirmed) return;
  std::vector<PoseCandidate*> unconfirmed;
  for (PoseCandidate& c : candidates)
    if (!c.result->refined && pairs[c.pair].search) unconfirmed.push_back(&c);
  std::vector<RefinedAlignment> results;
  for (const PoseCandidate* c : unconfirmed) results.push_back(begun_again(*c->result));
  std::vector<PoseCandidate> looks;
  for (size_t k = 0; k < results.size(); ++k)
    looks.push_back({unconfirmed[k]->pair, &results[k], results[k].T_10, {}, 0, kHalfSize});
  internal::run_rounds(aligner_, *feature_aligner_, options_, pairs, looks);
  internal::for_each_of(looks.size(), options_.threads, [&](size_t k) { conclude(pairs, looks[k]); });
  for (size_t k = 0; k < looks.size(); ++k) {
    if (!results[k].converged() || !results[k].found_again) continue;
    results[k].reason += "; features found at half the size";
    looks[k].result = unconfirmed[k]->result;
    *looks[k].result = std::move(results[k]);
    *unconfirmed[k] = std::move(looks[k]);
  }
}

void Refiner::conclude(std::span<const Pair> pairs, PoseCandidate& candidate) const {
  const Pair& pair = pairs[candidate.pair];
  internal::conclude(internal::view_of(aligner_, pair.reference), options_, pair, candidate);
}

void Refiner::question(std::span<const Pair> pairs, std::span<const PoseCandidate> candidates) {
  const Stopwatch time;
  std::vector<Contested> all = contested(pairs, candidates);
  const auto view = [&](const Contested& c) { return internal::view_of(aligner_, pairs[c.answer.pair].reference); };
  internal::for_each_of(all.size(), options_.threads, [&](size_t k) {
    const Pair& pair = pairs[all[k].answer.pair];
    all[k].elsewhere = internal::look_elsewhere(view(all[k]), options_, aligner_.grey(pair.reference), pair, all[k].answer);
    // A start that grey values did not find may be that of an object that passes a camera that stands still.
    if (pair.found) all[k].elsewhere.poses.emplace_back();
  });
  std::vector<PoseCandidate> rivals = rivals_of(all);
  internal::run_rounds(aligner_, *feature_aligner_, options_, pairs, rivals);
  for (PoseCandidate& rival : rivals) {
    conclude(pairs, rival);
    if (!rival.result->refined) rival.result->T_10 = rival.pose.T_10;  // compared nevertheless
  }
  for (Contested& c : all) settle(view(c), options_, c);
  const double ms = time.ms() / static_cast<double>(std::max<size_t>(all.size(), 1));
  for (const Contested& c : all) {
    RefinedAlignment& r = *c.answer.result;
    r.stages.push_back({"rivals", r.T_10, r.stages.back().cost, ms});
  }
}

}  // namespace iclk
