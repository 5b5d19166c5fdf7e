#include <iclk/refine/cascade.h>

#include <algorithm>
#include <cstring>
#include <iterator>
#include <map>
#include <string>
#include <utility>

#include <iclk/align/common/stopwatch.h>
#include <iclk/align/search/gradients.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/blur.h>
#include <iclk/refine/internal/rounds.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/refine/internal/verdict.h>

namespace iclk {
namespace {

/// The result for an alignment without refinement.
RefinedAlignment unrefined(const Reference& reference, Alignment alignment, double ms) {
  RefinedAlignment r;
  r.T_10 = alignment.T_10;
  r.covariance = alignment.covariance;
  if (!r.covariance.isZero(0))
    r.covariance += internal::depth_covariance(reference.camera, reference.features, alignment.features, r.T_10, 0);
  r.status = alignment.status;
  r.reason = alignment.reason;
  r.stages = {{"iclk", alignment.T_10, alignment.cost, ms}};
  r.inverse_depth = reference.features.inverse_depth;
  r.iclk = std::move(alignment);
  return r;
}

constexpr size_t kMostPixels = size_t{1} << 24;  // of targets with local contrast at a time

constexpr double kNear = 5;  // px, median motion of the features: the same pose, found in other images

/// 2: confirmed by features, 1: a claim of a model alone, 0: no claim.
int rank(const RefinedAlignment& r) { return r.converged() ? 1 + r.refined : 0; }

/// Whether an unconfirmed answer from images that were blurred alike is a refinement of the one from the images as they are.
bool refines(const internal::View& view, const RefinedAlignment& alike, const RefinedAlignment& given) {
  return rank(alike) >= rank(given) && internal::median_motion(view, alike.T_10, given.T_10) < kNear;
}

/// A view of a copy of the pixels, rows packed.
ImageView keep(const ImageView& image, std::vector<uint8_t>& pixels) {
  if (image.empty()) return {};
  ImageView kept = image;
  kept.row_stride = static_cast<size_t>(image.width) * bytes_per_pixel(image.format);
  pixels.resize(kept.row_stride * static_cast<size_t>(image.height));
  for (int v = 0; v < image.height; ++v)
    std::memcpy(pixels.data() + static_cast<size_t>(v) * kept.row_stride, image.row(v), kept.row_stride);
  kept.data = pixels.data();
  return kept;
}

}  // namespace

Cascade::Cascade(std::vector<Step> steps) : steps_(std::move(steps)), running_(steps_.size()) {
  if (steps_.empty()) throw Error(ErrorCode::invalid_argument, "a cascade needs at least one model");
  for (size_t step = 0; step < steps_.size(); ++step) {
    looks_.push_back({step});
    if (!steps_[step].refiner) continue;
    if (steps_[step].gradients) looks_.push_back({step, false, true});
    if (steps_[step].local_contrast) looks_.push_back({step, true});
  }
  looks_.front().first = looks_.back().last = true;
  start(0);
}

Cascade::~Cascade() = default;

void Cascade::start(size_t step) {
  if (running_[step].aligner) return;
  const internal::Stopwatch time;
  Running made;
  made.aligner = steps_[step].make();
  if (steps_[step].refiner) made.refiner = std::make_unique<Refiner>(*made.aligner, *steps_[step].refiner);
  made.refiner ? made.refiner->warm_up() : made.aligner->warm_up();
  running_[step] = std::move(made);
  times_.setup += time.ms();
}

void Cascade::prepare(size_t step, int slot) {
  const auto at = static_cast<size_t>(slot);
  std::vector<uint64_t>& prepared = running_[step].prepared;
  prepared.resize(std::max(prepared.size(), keyframes_.size()));
  if (prepared[at] == keyframes_[at].version) return;
  prepared[at] = 0;
  running_[step].aligner->set_reference(slot, keyframes_[at].reference);
  prepared[at] = keyframes_[at].version;
}

std::vector<RefinedAlignment> Cascade::run(size_t step, const std::vector<Pair>& pairs) {
  start(step);
  Running& running = running_[step];
  const internal::Stopwatch prepare_time;
  for (const Pair& pair : pairs) prepare(step, pair.reference);
  times_.prepare += prepare_time.ms();

  const internal::Stopwatch time;
  std::vector<RefinedAlignment> results;
  if (running.refiner) {
    results = running.refiner->align(pairs);
  } else {
    std::vector<Alignment> alignments = running.aligner->align(pairs);
    const double ms = time.ms() / static_cast<double>(pairs.size());
    for (size_t i = 0; i < pairs.size(); ++i)
      results.push_back(unrefined(keyframes_[static_cast<size_t>(pairs[i].reference)].reference, std::move(alignments[i]), ms));
  }
  times_.align += time.ms();
  return results;
}

std::vector<FeatureCheck> Cascade::set_reference(int slot, const Reference& reference) {
  const internal::Stopwatch time;
  Running& first = running_.front();
  const auto at = static_cast<size_t>(slot);
  // If this throws, the old keyframe is prepared again from its copy.
  if (slot >= 0 && at < first.prepared.size()) first.prepared[at] = 0;
  std::vector<FeatureCheck> checks = first.aligner->set_reference(slot, reference);
  Keyframe keyframe;
  keyframe.reference = reference;
  keyframe.reference.image = keep(reference.image, keyframe.image);
  keyframe.reference.inverse_depth = keep(reference.inverse_depth, keyframe.inverse_depth);
  keyframe.version = ++versions_;
  if (keyframes_.size() <= at) keyframes_.resize(at + 1);
  keyframes_[at] = std::move(keyframe);
  first.prepared.resize(std::max(first.prepared.size(), keyframes_.size()));
  first.prepared[at] = versions_;
  times_.prepare += time.ms();
  return checks;
}

const Reference* Cascade::reference(int slot) const {
  const auto at = static_cast<size_t>(slot);
  return slot >= 0 && at < keyframes_.size() && keyframes_[at].version != 0 ? &keyframes_[at].reference : nullptr;
}

std::vector<RefinedAlignment> Cascade::align(std::span<const CascadePair> pairs) {
  // Views of the caller's pixels, valid during this call only.
  keyframes_.assign(pairs.size(), {});
  std::vector<Pair> work;
  for (size_t i = 0; i < pairs.size(); ++i) {
    keyframes_[i].reference = pairs[i].reference;
    keyframes_[i].version = ++versions_;
    work.push_back({static_cast<int>(i), pairs[i].target, pairs[i].T_10, {}, pairs[i].search, pairs[i].target_mask});
  }
  struct Forget {
    std::vector<Keyframe>& keyframes;
    ~Forget() { keyframes.clear(); }
  } forget{keyframes_};
  return align(work);
}

std::vector<RefinedAlignment> Cascade::align(std::span<const Pair> pairs) {
  for (size_t i = 0; i < pairs.size(); ++i)
    if (reference(pairs[i].reference) == nullptr)
      throw Error(ErrorCode::invalid_argument, "pair " + std::to_string(i) + ": reference slot " +
                                                   std::to_string(pairs[i].reference) + " was not set; call set_reference");
  std::vector<RefinedAlignment> results = settle(pairs);
  for (size_t i = 0; i < pairs.size(); ++i)
    if (!results[i].fixed.empty()) look_past_overlay(pairs[i], results[i]);
  return results;
}

void Cascade::look_past_overlay(const Pair& pair, RefinedAlignment& result) {
  Keyframe& keyframe = keyframes_[static_cast<size_t>(pair.reference)];
  std::vector<double>& q = keyframe.reference.features.inverse_depth;
  const std::vector<double> whole = q;
  int fixed = 0;
  for (size_t i = 0; i < q.size(); ++i)
    if (result.fixed[i]) q[i] = 0, ++fixed;  // such a feature is not used
  keyframe.version = ++versions_;
  RefinedAlignment other = settle({&pair, 1}).front();
  q = whole;
  keyframe.version = ++versions_;
  if (!other.converged() || other.inliers <= fixed) return;
  const Running& first = running_.front();  // it has the other features only
  const double apart = internal::median_motion(internal::view_of(*first.aligner, pair.reference), other.T_10, result.T_10);
  if (!(apart > steps_.front().refiner->pose.inlier_distance)) return;  // more of the overlay, or the scene does not move
  other.fixed = std::move(result.fixed);
  for (size_t i = 0; i < whole.size(); ++i)
    if (other.fixed[i]) other.inverse_depth[i] = whole[i];
  other.reason += "; " + std::to_string(fixed) + " features that are fixed to the camera are left out";
  result = std::move(other);
}

/// Pairs with other images. The keyframes have theirs back at the end.
class Cascade::Changed {
 public:
  Changed(Cascade& cascade, std::span<const Pair> given, bool local_contrast, const internal::PairBlur* blur)
      : Changed(cascade) {  // from here on, the destructor runs even if this throws
    pairs.assign(given.begin(), given.end());
    for (Pair& pair : pairs) {
      Keyframe& keyframe = cascade.keyframes_[static_cast<size_t>(pair.reference)];
      if (own_.try_emplace(pair.reference, keyframe.reference.image).second) {
        if (blur) keyframe.reference.image = keep(internal::blurred(keyframe.reference.image, blur->target_in_reference));
        if (local_contrast) keyframe.reference.image = keep(internal::local_contrast(keyframe.reference.image));
        keyframe.version = ++cascade.versions_;
      }
      if (blur) pair.target = keep(internal::blurred(pair.target, blur->reference_in_target));
      if (blur && !pair.target_mask.empty())
        pair.target_mask = masks_.emplace_back(internal::blurred_mask(pair.target_mask, blur->reference_in_target)).view;
      if (local_contrast) pair.target = keep(internal::local_contrast(pair.target, pair.target_mask));
    }
  }
  ~Changed() {
    for (const auto& [slot, image] : own_) {
      Keyframe& keyframe = cascade_.keyframes_[static_cast<size_t>(slot)];
      keyframe.reference.image = image;
      keyframe.version = ++cascade_.versions_;
    }
  }
  Changed(const Changed&) = delete;
  Changed& operator=(const Changed&) = delete;

  std::vector<Pair> pairs;

 private:
  explicit Changed(Cascade& cascade) : cascade_(cascade) {}
  ImageView keep(internal::FloatImage image) { return images_.emplace_back(std::move(image)).view; }

  Cascade& cascade_;
  std::map<int, ImageView> own_;  // by slot
  std::vector<internal::FloatImage> images_;
  std::vector<internal::BlurredMask> masks_;
};

std::vector<RefinedAlignment> Cascade::run(const Look& look, const std::vector<Pair>& pairs) {
  if (pairs.empty()) return {};
  std::vector<RefinedAlignment> answers;
  if (!look.local_contrast) {
    answers = run(look.step, pairs);
    if (look.gradients) std::for_each(answers.begin(), answers.end(), internal::judge_second_look);
    return answers;
  }
  const ImageView& image = pairs.front().target;
  const size_t at_once =
      std::max(size_t{1}, kMostPixels / (static_cast<size_t>(image.width) * static_cast<size_t>(image.height)));
  for (size_t first = 0; first < pairs.size(); first += at_once) {
    const Changed changed(*this, std::span(pairs).subspan(first, std::min(at_once, pairs.size() - first)), true, nullptr);
    for (RefinedAlignment& r : run(look.step, changed.pairs)) answers.push_back(std::move(r));
  }
  for (RefinedAlignment& r : answers) {
    r.reason += "; by local contrast";
    internal::judge_second_look(r);
  }
  return answers;
}

std::optional<internal::PairBlur> Cascade::blur_of(const Pair& pair, const RefinedAlignment& given) const {
  if (rank(given) == 2 || given.status == Status::ambiguous) return {};
  const Reference& reference = keyframes_[static_cast<size_t>(pair.reference)].reference;
  return internal::find_blur(grey_map(reference.image), grey_map(pair.target), reference.camera, reference.features,
                             given.T_10);
}

std::optional<RefinedAlignment> Cascade::align_alike(const Look& look, const Pair& pair, const internal::PairBlur& blur,
                                                     const RefinedAlignment& given) {
  const Changed changed(*this, {&pair, 1}, look.local_contrast, &blur);
  RefinedAlignment answer = run(look.step, changed.pairs).front();
  internal::judge_second_look(answer);
  const internal::View view = internal::view_of(*running_[look.step].aligner, pair.reference);
  if (rank(answer) < 2 && !refines(view, answer, given)) return {};
  answer.blur = RefinedAlignment::Blur{blur.reference, blur.target};
  answer.reason += look.local_contrast ? "; by local contrast, both images blurred alike" : "; both images blurred alike";
  return answer;
}

RefinedAlignment Cascade::answer_alike(const Look& look, const Pair& pair, const internal::PairBlur& blur,
                                       const RefinedAlignment& given) {
  std::optional<RefinedAlignment> alike = align_alike(look, pair, blur, given);
  return alike ? std::move(*alike) : run(look, {pair}).front();
}

RefinedAlignment Cascade::look_past_blur(const Look& look, const Pair& pair, RefinedAlignment answer,
                                         std::optional<internal::PairBlur>& blur) {
  if (!steps_[look.step].refiner || !steps_[look.step].blur || (look.first && !look.last) || look.gradients) return answer;
  blur = blur_of(pair, answer);
  if (!blur || !(look.last || look.local_contrast || answer.converged())) return answer;
  std::optional<RefinedAlignment> alike = align_alike(look, pair, *blur, answer);
  return alike ? std::move(*alike) : answer;
}

void Cascade::find_starts(const std::vector<size_t>& left, int threads, std::vector<Pair>& pairs) const {
  for (const size_t i : left) {
    Pair& pair = pairs[i];
    const Aligner& aligner = *running_.front().aligner;
    if (!pair.search || pair.found || pair.prior || aligner.plan().dense) continue;
    const std::optional<SE3> start = internal::start_by_gradients(keyframes_[static_cast<size_t>(pair.reference)].reference,
                                                                  aligner.checks(pair.reference), pair, threads);
    if (start) pair.T_10 = *start, pair.found = true;
  }
}

std::vector<RefinedAlignment> Cascade::settle(std::span<const Pair> given) {
  std::vector<Pair> pairs(given.begin(), given.end());
  std::vector<RefinedAlignment> results(pairs.size());
  std::vector<std::optional<internal::PairBlur>> blurs(pairs.size());
  std::vector<std::optional<Opinion>> by_contrast(pairs.size());
  std::vector<size_t> left(pairs.size());
  for (size_t i = 0; i < left.size(); ++i) left[i] = i;
  for (const Look& look : looks_) {
    std::vector<size_t> skipped;
    if (look.gradients) {
      find_starts(left, steps_[look.step].refiner->threads, pairs);
      std::partition_copy(left.begin(), left.end(), std::back_inserter(skipped), left.begin(),
                          [&](size_t i) { return !pairs[i].found; });
      left.resize(left.size() - skipped.size());
    }
    std::vector<Pair> work;
    for (const size_t i : left)
      if (!blurs[i]) work.push_back(pairs[i]);
    std::vector<RefinedAlignment> answers = run(look, work);
    auto next = answers.begin();
    std::vector<size_t> unsettled;
    for (const size_t i : left) {
      RefinedAlignment& r = results[i];
      RefinedAlignment answer =
          blurs[i] ? answer_alike(look, pairs[i], *blurs[i], r) : look_past_blur(look, pairs[i], std::move(*next++), blurs[i]);
      if (look.local_contrast) by_contrast[i] = Opinion{look.step, answer.T_10};
      answer.model = steps_[look.step].model;
      std::vector<Attempt> attempts = std::move(r.attempts);
      attempts.push_back({answer.model + (look.local_contrast ? ", local contrast"
                                          : look.gradients    ? ", gradients"
                                                              : ""),
                          answer.status, answer.reason});
      const bool settled = answer.converged() || answer.status == Status::ambiguous;
      const double repeats = std::max(r.iclk.repeats, answer.iclk.repeats);  // looks with a start do not search
      if (settled || answer.inliers >= r.inliers) r = std::move(answer);
      r.iclk.repeats = repeats;
      r.attempts = std::move(attempts);
      if (!settled) unsettled.push_back(i);
    }
    unsettled.insert(unsettled.end(), skipped.begin(), skipped.end());
    left = std::move(unsettled);
    if (look.local_contrast && !look.last) {
      for (const size_t i : left) look_at_lines(pairs[i], *by_contrast[i], results[i], false);
      std::erase_if(left, [&](size_t i) { return results[i].by_lines; });
    }
  }
  for (size_t i = 0; i < pairs.size(); ++i) {
    if (!by_contrast[i] && steps_[0].local_contrast && internal::weakly_confirmed(results[i]))
      by_contrast[i] = Opinion{0, results[i].T_10};
    if (by_contrast[i]) look_at_lines(pairs[i], *by_contrast[i], results[i], true);
  }
  return results;
}

}  // namespace iclk
