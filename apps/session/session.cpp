#include "apps/session/session.h"

#include <algorithm>
#include <chrono>
#include <cstdio>

#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>

#include "apps/io/images.h"
#include "apps/session/any_aligner.h"

namespace iclk {
namespace {

using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point start) { return std::chrono::duration<double, std::milli>(Clock::now() - start).count(); }

/// A device format that loses nothing of the images.
PixelFormat device_format(const PairInput& pair) {
  const bool deep = pair.image_0.depth() != CV_8U || pair.image_1.depth() != CV_8U;
  // A mask goes into the alpha of four channels.
  const bool colour = pair.image_0.channels() > 1 || pair.image_1.channels() > 1 || !pair.mask_1.empty();
  if (deep) return colour ? PixelFormat::rgba32f : PixelFormat::r32f;
  return colour ? PixelFormat::rgba8 : PixelFormat::r8;
}

cv::Mat inverse_depth_of(const PairInput& pair) {
  if (pair.depth_0.empty())
    throw Error(ErrorCode::invalid_argument, pair.name_0 + ": --dense needs a depth image (--depth), not only features");
  cv::Mat inverse;
  cv::divide(1.0, pair.depth_0, inverse);
  inverse.setTo(0, pair.depth_0 <= 0);
  return inverse;
}

}  // namespace

std::string SessionOptions::model_name() const { return then.empty() ? iclk::model_name(model.get()) : "auto"; }

Session::Session(const SessionOptions& options) : options_(options) {
  options_.aligner.check();
  for (const ModelStage& stage : options_.then) stage.aligner.check();
  options_.refiner.check();
  if (options_.max_pairs < 1)
    throw Error(ErrorCode::invalid_argument, "batch size " + std::to_string(options_.max_pairs) + " must be positive");
  if (options_.solver == Solver::cpu) {
    device_name_ = "CPU reference (one thread, no Vulkan)";
    return;
  }
  context_ = open_device(options_.device);
  device_name_ = context_->info().name;
}

void Session::make_aligner(const PairInput& pair, int features) {
  Plan plan;
  plan.width = pair.image_0.cols;
  plan.height = pair.image_0.rows;
  plan.max_features = std::max(features, 1);
  plan.max_references = plan.max_pairs = options_.max_pairs;
  plan.dense = options_.dense;
  plan.target_masks = !pair.mask_1.empty();
  plan.format = device_format(pair);
  const bool fits = cascade_ && plan.width == plan_.width && plan.height == plan_.height && plan.format == plan_.format &&
                    plan.target_masks == plan_.target_masks && plan.max_features <= plan_.max_features;
  if (fits) return;
  try {
    make_plan(plan);
  } catch (const Error& e) {
    std::string remedy;
    if (e.code() == ErrorCode::unsupported) remedy = " (--solver cpu)";
    if (std::min(plan.width, plan.height) < 3 << (options_.aligner.levels - 1)) remedy = " (--levels)";
    throw Error(e.code(), pair.name_0 + ": " + e.what() + remedy);
  }
  plan_ = plan;
}

void Session::make_plan(const Plan& plan) {
  cascade_.reset();
  device_aligners_.clear();
  std::vector<ModelStage> stages = {{options_.aligner, options_.model}};
  stages.insert(stages.end(), options_.then.begin(), options_.then.end());
  std::vector<Cascade::Step> steps;
  for (const ModelStage& stage : stages) {
    const std::string name = iclk::model_name(stage.model.get());
    const auto make = [this, plan, stage, name] {
      auto aligner = make_any_aligner(options_.solver, context_, plan, stage.aligner, stage.model);
      if (auto* on_device = dynamic_cast<DeviceAligner*>(aligner.get())) {
        on_device->enable_timing(options_.profile);
        device_aligners_.emplace_back(name, on_device);
      }
      return aligner;
    };
    RefinerOptions refiner = options_.refiner;
    refiner.keep_unconfirmed = stage.model != nullptr;
    steps.push_back({name, make, options_.refine ? std::optional(refiner) : std::nullopt});
  }
  cascade_ = std::make_unique<Cascade>(std::move(steps));
}

std::vector<RefinedAlignment> Session::run(std::span<const PairInput> pairs) {
  std::vector<RefinedAlignment> results;
  times_ = {};
  for (size_t first = 0; first < pairs.size();) {
    const size_t count = std::min(pairs.size() - first, static_cast<size_t>(options_.max_pairs));
    const auto batch = pairs.subspan(first, count);
    first += count;

    const auto start = Clock::now();
    int features = 0;
    for (const PairInput& pair : batch) features = std::max(features, pair.features.size());
    make_aligner(batch.front(), features);
    times_.setup += ms_since(start);

    const Cascade::Times before = cascade_->times();
    std::vector<cv::Mat> inverse;
    std::vector<CascadePair> work;
    for (const PairInput& pair : batch) {
      work.push_back({{view(pair.image_0), pair.camera, pair.features, {}},
                      view(pair.image_1),
                      pair.T_10,
                      options_.search_guessed || !pair.guessed,
                      pair.mask_1.empty() ? ImageView() : view(pair.mask_1)});
      if (!options_.dense) continue;
      inverse.push_back(inverse_depth_of(pair));
      work.back().reference.inverse_depth = view(inverse.back());
    }
    for (RefinedAlignment& r : cascade_->align(work)) results.push_back(std::move(r));
    times_.setup += cascade_->times().setup - before.setup;
    times_.prepare += cascade_->times().prepare - before.prepare;
    times_.align += cascade_->times().align - before.align;
  }
  return results;
}

std::string Session::profile_text(const PairInput& pair) const {
  std::string out;
  const auto row = [&](const char* stage, double ms) {
    char line[80];
    std::snprintf(line, sizeof line, "  %-22s %9.3f ms\n", stage, ms);
    out += line;
  };
  row("load", pair.load_ms);
  row("detect", pair.detect_ms);
  row("setup", times_.setup);
  row("prepare", times_.prepare);
  row("align", times_.align);
  for (const auto& [model, aligner] : device_aligners_) {
    if (aligner->times().empty()) continue;
    out += "  on the device, all runs" + (device_aligners_.size() > 1 ? ", " + model : "") + ":\n";
    for (const engine::StageTime& stage : aligner->times()) row(("  " + stage.name).c_str(), stage.milliseconds);
  }
  return out;
}

}  // namespace iclk
