#include <iclk/session/session.h>

#include <algorithm>
#include <cstdlib>

#include <iclk/align/common/stopwatch.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/session/device.h>

namespace iclk {
namespace {

std::unique_ptr<Aligner> make_any_aligner(Solver solver, const std::shared_ptr<engine::Context>& context, const Plan& plan,
                                          const ModelStage& stage) {
  if (solver == Solver::cpu) return make_cpu_aligner(plan, stage.aligner, stage.model);
  return make_device_aligner(context, plan, stage.aligner, solver, stage.model);
}

/// With the device that a session opens if none is named.
SessionOptions with_device(SessionOptions options) {
  if (const char* variable = std::getenv("ICLK_DEVICE"); variable && options.device.empty()) options.device = variable;
  return options;
}

SessionOptions checked(SessionOptions options) {
  if (options.device == "cpu") options.solver = Solver::cpu;
  if (options.batch < 1 || options.references < 1)
    throw Error(ErrorCode::invalid_argument, "references " + std::to_string(options.references) + " and batch " +
                                                 std::to_string(options.batch) + " must be positive");
  options.refiner.check();
  return options;
}

std::vector<ModelStage> checked_stages(const SessionOptions& options) {
  std::vector<ModelStage> stages = make_stages(options);
  for (const ModelStage& stage : stages) stage.aligner.check();
  return stages;
}

}  // namespace

PixelFormat lossless_format(bool deep, bool colour) {
  if (deep) return colour ? PixelFormat::rgba32f : PixelFormat::r32f;
  return colour ? PixelFormat::rgba8 : PixelFormat::r8;
}

Session::Session(const SessionOptions& options) : options_(checked(with_device(options))), stages_(checked_stages(options_)) {
  if (options_.solver != Solver::cpu) context_ = open_device(options_.device);
}

Session::Session(const SessionOptions& options, std::shared_ptr<engine::Context> context)
    : options_(checked(options)), stages_(checked_stages(options_)), context_(std::move(context)) {
  if (options_.solver == Solver::cpu) context_.reset();
  if (options_.solver != Solver::cpu && !context_)
    throw Error(ErrorCode::invalid_argument, "a session without a Vulkan context needs Solver::cpu");
}

Session::~Session() = default;

void Session::Needs::add(const ImageView& image) {
  if (width == 0) width = image.width, height = image.height;
  deep = deep || bytes_per_pixel(image.format) != static_cast<size_t>(channels(image.format));
  colour = colour || channels(image.format) > 1;
}

bool Session::Needs::serves(const Needs& other) const {
  return width == other.width && height == other.height && deep == other.deep && masks == other.masks &&
         (colour || masks) == (other.colour || other.masks) && features >= other.features && references >= other.references &&
         (search || !other.search);
}

Plan Session::plan_for(const Needs& needs) const {
  Plan plan{needs.width, needs.height};
  plan.max_features = needs.features;
  plan.max_references = needs.references;
  plan.max_pairs = options_.batch;
  plan.dense = options_.dense;
  plan.target_masks = needs.masks;
  plan.format = lossless_format(needs.deep, needs.colour || needs.masks);  // a mask is stored in the alpha of four channels
  return plan;
}

std::unique_ptr<Cascade> Session::make_cascade(const Needs& needs) {
  std::vector<Cascade::Step> steps;
  for (const ModelStage& known : stages_) {
    ModelStage stage = known;
    stage.aligner.search = stage.aligner.search && needs.search;
    const std::string name = iclk::model_name(stage.model.get());
    const auto make = [this, plan = plan_for(needs), stage, name] {
      auto aligner = make_any_aligner(options_.solver, context_, plan, stage);
      if (auto* on_device = dynamic_cast<DeviceAligner*>(aligner.get()); on_device && options_.profile) {
        on_device->enable_timing(true);
        device_aligners_.emplace_back(name, on_device);
      }
      return aligner;
    };
    RefinerOptions refiner = options_.refiner;
    refiner.keep_unconfirmed = stage.model != nullptr;
    const bool classical_again = options_.second_looks && stage.model == nullptr;
    steps.push_back({name, make, options_.refine ? std::optional(refiner) : std::nullopt, classical_again,
                     classical_again && stage.aligner.search, options_.second_looks});
  }
  return std::make_unique<Cascade>(std::move(steps));
}

void Session::make(const Needs& needs, bool keep_references) {
  if (cascade_ && made_.serves(needs)) return;
  const internal::Stopwatch time;
  device_aligners_.clear();
  if (!keep_references) cascade_.reset();  // both may not fit the device
  std::unique_ptr<Cascade> cascade = make_cascade(needs);
  for (int slot = 0; cascade_ && slot < made_.references; ++slot)
    if (const Reference* kept = cascade_->reference(slot)) cascade->set_reference(slot, *kept);
  cascade_ = std::move(cascade);
  made_ = needs;
  making_ms_ += time.ms();
}

bool Session::searches(bool without_guess) const { return without_guess || options_.search == SearchMode::on; }

void Session::expect(int width, int height, int features) {
  Needs needs = keyframes_;
  needs.width = width, needs.height = height;
  needs.features = std::max(needs.features, features);
  for (const ModelStage& stage : stages_) plan_for(needs).check(stage.aligner);
  keyframes_ = needs;
}

std::vector<FeatureCheck> Session::set_reference(int slot, const Reference& reference) {
  Needs needs = keyframes_;
  needs.add(reference.image);
  needs.features = std::max(needs.features, reference.features.size());
  needs.references = options_.references;
  needs.search = true;  // a target without a first guess may follow
  make(needs, true);
  keyframes_ = needs;
  return cascade_->set_reference(slot, reference);
}

std::vector<RefinedAlignment> Session::align(std::span<const Pair> pairs) {
  if (!cascade_ && !pairs.empty())
    throw Error(ErrorCode::invalid_argument,
                "pair 0: reference slot " + std::to_string(pairs[0].reference) + " was not set; call set_reference");
  Needs needs = keyframes_;
  std::vector<Pair> work(pairs.begin(), pairs.end());
  for (Pair& pair : work) {
    needs.add(pair.target);
    needs.masks = needs.masks || !pair.target_mask.empty();
    pair.search = searches(pair.search);
  }
  if (pairs.empty()) return {};
  make(needs, true);
  keyframes_ = needs;
  const Cascade::Times before = cascade_->times();
  std::vector<RefinedAlignment> results = cascade_->align(work);
  count(before);
  return results;
}

Session::Needs Session::needs_of(std::span<const CascadePair> pairs) const {
  Needs needs;
  for (const CascadePair& pair : pairs) {
    needs.add(pair.reference.image);
    needs.add(pair.target);
    needs.features = std::max(needs.features, pair.reference.features.size());
    needs.masks = needs.masks || !pair.target_mask.empty();
    needs.search = needs.search || searches(pair.search);
  }
  needs.references = options_.batch;
  return needs;
}

void Session::prepare(std::span<const CascadePair> pairs) {
  if (!pairs.empty()) make(needs_of(pairs), false);
}

std::vector<RefinedAlignment> Session::align(std::span<const CascadePair> pairs) {
  prepare(pairs);
  if (pairs.empty()) return {};
  const Cascade::Times before = cascade_->times();
  std::vector<CascadePair> work(pairs.begin(), pairs.end());
  for (CascadePair& pair : work) pair.search = searches(pair.search);
  std::vector<RefinedAlignment> results;
  const auto step = static_cast<size_t>(options_.batch);
  for (size_t first = 0; first < work.size(); first += step) {
    const std::span<const CascadePair> batch(work.data() + first, std::min(step, work.size() - first));
    for (RefinedAlignment& r : cascade_->align(batch)) results.push_back(std::move(r));
  }
  count(before);
  return results;
}

void Session::count(const Cascade::Times& before) {
  const Cascade::Times& now = cascade_->times();
  times_ = {now.setup - before.setup + making_ms_, now.prepare - before.prepare, now.align - before.align};
  making_ms_ = 0;
}

Answer Session::align(const ImageView& reference, const ImageView& depth, const ImageView& target, const Camera& camera,
                      const std::optional<SE3>& T_10) {
  Reference made{reference, camera, detect_features(reference, depth, {}, options_.detector), {}};
  return align(made, target, T_10);
}

Answer Session::align(const Reference& reference, const ImageView& target, const std::optional<SE3>& T_10) {
  CascadePair pair{reference, target, T_10.value_or(SE3()), !T_10, {}};
  options_.depth_sigma.apply(reference.camera, pair.reference.features);
  Answer answer{align(pair), {}};
  answer.reference_features = std::move(pair.reference.features);
  return answer;
}

std::unique_ptr<Aligner> Session::make_aligner(const Plan& plan) const {
  return make_any_aligner(options_.solver, context_, plan, stages_.front());
}

std::string Session::device_name() const { return context_ ? context_->info().name : "CPU reference (one thread, no Vulkan)"; }

std::vector<std::pair<std::string, std::vector<engine::StageTime>>> Session::stage_times() const {
  std::vector<std::pair<std::string, std::vector<engine::StageTime>>> times;
  for (const auto& [model, aligner] : device_aligners_)
    if (!aligner->times().empty()) times.emplace_back(model, aligner->times());
  return times;
}

}  // namespace iclk
