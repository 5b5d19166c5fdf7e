#include <iclk/refine/cascade.h>

#include <chrono>

#include <iclk/engine/error.h>
#include <iclk/refine/internal/uncertainty.h>

namespace iclk {
namespace {

using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point start) { return std::chrono::duration<double, std::milli>(Clock::now() - start).count(); }

/// An alignment that nothing was done to.
RefinedAlignment unrefined(const CascadePair& pair, Alignment alignment, double ms) {
  RefinedAlignment r;
  r.T_10 = alignment.T_10;
  r.covariance = alignment.covariance;
  if (!r.covariance.isZero(0))
    r.covariance += internal::depth_covariance(pair.reference.camera, pair.reference.features, alignment.features, r.T_10, 0);
  r.status = alignment.status;
  r.reason = alignment.reason;
  r.stages = {{"iclk", alignment.T_10, alignment.cost, ms}};
  r.inverse_depth = pair.reference.features.inverse_depth;
  r.iclk = std::move(alignment);
  return r;
}

}  // namespace

Cascade::Cascade(std::vector<Step> steps) : steps_(std::move(steps)), running_(steps_.size()) {
  if (steps_.empty()) throw Error(ErrorCode::invalid_argument, "a cascade needs one model at least");
  start(0);
}

Cascade::~Cascade() = default;

void Cascade::start(size_t step) {
  if (running_[step].aligner) return;
  const auto begin = Clock::now();
  Running made;
  made.aligner = steps_[step].make();
  if (steps_[step].refiner) made.refiner = std::make_unique<Refiner>(*made.aligner, *steps_[step].refiner);
  running_[step] = std::move(made);
  times_.setup += ms_since(begin);
}

std::vector<RefinedAlignment> Cascade::run(size_t step, std::span<const CascadePair* const> pairs) {
  start(step);
  Running& running = running_[step];
  auto begin = Clock::now();
  std::vector<Pair> work;
  for (size_t i = 0; i < pairs.size(); ++i) {
    const int slot = static_cast<int>(i);
    running.aligner->set_reference(slot, pairs[i]->reference);
    work.push_back({slot, pairs[i]->target, pairs[i]->T_10, {}, pairs[i]->search, pairs[i]->target_mask});
  }
  times_.prepare += ms_since(begin);

  begin = Clock::now();
  std::vector<RefinedAlignment> results;
  if (running.refiner) {
    results = running.refiner->align(work);
  } else {
    std::vector<Alignment> alignments = running.aligner->align(work);
    const double ms = ms_since(begin) / static_cast<double>(pairs.size());
    for (size_t i = 0; i < pairs.size(); ++i) results.push_back(unrefined(*pairs[i], std::move(alignments[i]), ms));
  }
  times_.align += ms_since(begin);
  return results;
}

std::vector<RefinedAlignment> Cascade::align(std::span<const CascadePair> pairs) {
  std::vector<RefinedAlignment> results(pairs.size());
  std::vector<size_t> left(pairs.size());
  for (size_t i = 0; i < left.size(); ++i) left[i] = i;
  for (size_t step = 0; step < steps_.size() && !left.empty(); ++step) {
    std::vector<const CascadePair*> work;
    for (const size_t i : left) work.push_back(&pairs[i]);
    std::vector<RefinedAlignment> answers = run(step, work);
    std::vector<size_t> unsettled;
    for (size_t k = 0; k < left.size(); ++k) {
      std::vector<Attempt> attempts = std::move(results[left[k]].attempts);
      attempts.push_back({steps_[step].model, answers[k].status, answers[k].reason});
      RefinedAlignment& r = results[left[k]] = std::move(answers[k]);
      r.model = steps_[step].model;
      r.attempts = std::move(attempts);
      if (!r.converged()) unsettled.push_back(left[k]);
    }
    left = std::move(unsettled);
  }
  return results;
}

}  // namespace iclk
