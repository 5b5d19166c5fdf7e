#include <iclk/align/network/layer_times.h>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <map>
#include <optional>
#include <set>
#include <span>

#include <iclk/align/network/feature_maps.h>
#include <iclk/align/network/tiling.h>
#include <iclk/engine/submission.h>

namespace iclk::internal {
namespace {

// A CPU device runs in this process, so its processor time is measured, which other processes disturb least. Else wall time.
double now(engine::DeviceType type) {
  if (type == engine::DeviceType::cpu) return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// The step of a shape, before its weights are packed.
ConvStep step_of(const ConvShape& shape, ConvVariant variant, const engine::Context& context) {
  ConvStep step;
  step.variant = variant;
  step.dilation = static_cast<uint32_t>(shape.dilation);
  step.in = {static_cast<uint32_t>(shape.width), static_cast<uint32_t>(shape.height), static_cast<uint32_t>(shape.in), 1,
             step.dilation};
  step.out = step.in;
  step.out.channels = static_cast<uint32_t>(shape.out);
  if (shape.last) {
    step.half = step.out;
    step.half.width /= 2;
    step.half.height /= 2;
  }
  step.fused = can_fuse(step, context);
  step.reduced = shape.last && can_reduce(step);
  step.whole_map = true;
  return step;
}

// A place as in the finest levels, with rows of whole vec4.
MapPlace place_of(const ConvStep& step) {
  const uint32_t width = step.out.width, height = step.out.height, pitch = (width + 3) / 4 * 4;
  return {0, pitch, pitch * height, 0, 0, width, height};
}

struct Kernels {
  Kernels(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes) : maps(context) {
    for (ConvVariant variant : kConvVariants) {
      std::vector<ConvStep> steps;
      for (const ConvShape& shape : shapes)
        if (const ConvStep step = step_of(shape, variant, *context); has_kernel(step, *context)) steps.push_back(step);
      if (!steps.empty()) convolutions.try_emplace(variant, context, std::span<const ConvStep>(steps));
    }
  }
  FeatureMaps maps;
  std::map<ConvVariant, ConvKernels> convolutions;
};

// The input and output of all variants of a layer.
struct Tensors {
  Tensors(const std::shared_ptr<const engine::Context>& context, const ConvShape& shape) {
    const ConvStep step = step_of(shape, ConvVariant::direct, *context);
    // A reduced output with its sums is smaller than a whole one, except for very small images.
    const uint64_t reduced = shape.last ? channel_sums(step).texels(1) : 0;
    engine::MemoryPlan plan;
    const auto add = [&](const char* what, uint64_t texels) {
      return plan.add(what, kTexelBytes * texels, engine::MemoryKind::device, ConvKernels::kActivations, kTexelFormat);
    };
    x = add("timed layer: input", std::max(step.in.texels(), step.half.texels()));
    y = add("timed layer: output", std::max(step.out.texels(), reduced));
    map = plan.add("timed layer: map", 4ull * place_of(step).stride, engine::MemoryKind::device, engine::BufferUse::storage);
    memory.emplace(context, plan);
    engine::Submission fill(context);
    engine::DescriptorArena arena(context, {});
    engine::Recorder recorder(fill, arena);
    // 0.5, because denormals and NaN take different times.
    recorder.fill((*memory)[x], 0x3f000000u);
    fill.end();
    fill.submit_and_wait();
  }
  engine::BufferId x, y, map;
  std::optional<engine::Workspace> memory;
};

// A layer in one variant, ready to run.
class Trial {
 public:
  Trial(const std::shared_ptr<const engine::Context>& context, const Kernels& kernels, const ConvKernels& convolutions,
        const ConvShape& shape, ConvVariant variant, const Tensors& tensors)
      : type_(context->info().type), submission_(context) {
    const size_t in = static_cast<size_t>(shape.in), out = static_cast<size_t>(shape.out);
    const ConvLayer layer{shape.in, shape.out, shape.dilation, std::vector<float>(9 * in * out, 1e-3f),
                          std::vector<float>(out, 0.1f)};
    ConvStep step = step_of(shape, variant, *context);
    PackedWeights packed;
    step.packed = packed.add(layer, variant);
    engine::MemoryPlan plan;
    const auto add = [&](const char* what, uint64_t texels, engine::BufferUse use) {
      return plan.add(what, kTexelBytes * texels, engine::MemoryKind::device, use, kTexelFormat);
    };
    using Uses = ConvKernels;
    const auto w = add("timed layer: weights", packed.data().size() / 4, Uses::kWeights),
               tiles = add("timed layer: tiles", std::max<uint64_t>(Uses::scratch_texels(step), 1), Uses::kScratch);
    memory_.emplace(context, plan);
    write_buffer(context, (*memory_)[w], packed.data());
    engine::ArenaSize size;
    convolutions.add_to(size);
    kernels.maps.add_to(size, 1);
    arena_.emplace(context, size);
    if (type_ != engine::DeviceType::cpu) timer_.emplace(context, 1);
    engine::Recorder recorder(submission_, *arena_, timer_ ? &*timer_ : nullptr);
    recorder.stage("layer");
    const engine::Workspace& shared = *tensors.memory;
    const engine::Buffer &x = shared[tensors.x], &y = shared[tensors.y], &scratch = (*memory_)[tiles];
    if (step.fused) convolutions.record_start(recorder, scratch);
    const MapPlace place = place_of(step);
    const MapPart part{&shared[tensors.map], 0, 1, 0};
    convolutions.record(recorder, step, x, (*memory_)[w], y, scratch, place, std::span(&part, 1));
    if (shape.last && !writes_map(step)) kernels.maps.record(recorder, step, y, x, place, part);
    recorder.finish();
    submission_.end();
  }

  // Returns seconds. The submission of a small layer takes longer than its run on a GPU, so timestamps of the device are used
  // if it has them.
  double run() {
    const double begin = now(type_);
    submission_.submit_and_wait();
    const double taken = now(type_) - begin;
    if (!timer_ || !timer_->available()) return taken;
    timer_->clear();
    timer_->collect();
    return 1e-3 * timer_->times().front().milliseconds;
  }

 private:
  engine::DeviceType type_;
  std::optional<engine::Workspace> memory_;
  std::optional<engine::DescriptorArena> arena_;
  std::optional<engine::StageTimer> timer_;
  engine::Submission submission_;
};

LayerTimes time_layer(const std::shared_ptr<const engine::Context>& context, const Kernels& kernels, const ConvShape& shape,
                      int repetitions) {
  const Tensors tensors(context, shape);
  std::map<ConvVariant, Trial> trials;
  std::map<ConvVariant, std::vector<double>> seconds;
  for (const auto& [variant, convolutions] : kernels.convolutions)
    if (has_kernel(step_of(shape, variant, *context), *context))
      // The first run compiles and is not counted.
      trials.try_emplace(variant, context, kernels, convolutions, shape, variant, tensors).first->second.run();
  // They take turns, so that temporary load of the machine affects all of them.
  for (int run = 0; run < repetitions; ++run)
    for (auto& [variant, trial] : trials) seconds[variant].push_back(trial.run());
  LayerTimes times{shape, {}};
  for (auto& [variant, all] : seconds) {
    std::sort(all.begin(), all.end());
    times.ways.push_back({variant, all[all.size() / 2], all.front()});
  }
  return times;
}

}  // namespace

std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels) {
  levels = std::min(levels, model.levels());
  const Tiling tiling(model, static_cast<uint32_t>(width), static_cast<uint32_t>(height), levels);
  std::set<ConvShape> shapes;
  for (int l = 0; l < levels; ++l)
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(l)])
      shapes.insert({layer.in, layer.out, layer.dilation, static_cast<int>(tiling.width >> l),
                     static_cast<int>(tiling.height >> l), &layer == &model.encoder[static_cast<size_t>(l)].back()});
  return {shapes.begin(), shapes.end()};
}

const LayerTimes::Way& LayerTimes::fastest() const {
  return *std::min_element(ways.begin(), ways.end(), [](const Way& a, const Way& b) { return a.least < b.least; });
}

const LayerTimes::Way* LayerTimes::way(ConvVariant variant) const {
  const auto found = std::find_if(ways.begin(), ways.end(), [&](const Way& way) { return way.variant == variant; });
  return found != ways.end() ? &*found : nullptr;
}

std::vector<LayerTimes> time_layers(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes,
                                    int repetitions, const std::function<void(int, int)>& progress) {
  std::vector<LayerTimes> times;
  if (shapes.empty()) return times;
  const Kernels kernels(context, shapes);
  for (const ConvShape& shape : shapes) {
    progress(static_cast<int>(times.size()), static_cast<int>(shapes.size()));
    times.push_back(time_layer(context, kernels, shape, repetitions));
  }
  return times;
}

}  // namespace iclk::internal
