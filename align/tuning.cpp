#include <iclk/align/tuning.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <ctime>
#include <deque>
#include <optional>
#include <set>
#include <span>
#include <sstream>

#include <iclk/align/internal/feature_maps.h>
#include <iclk/align/internal/tiling.h>
#include <iclk/engine/submission.h>

namespace iclk {
namespace {

constexpr std::string_view kHeader = "iclk-tuning 4";
constexpr ConvVariant kVariants[] = {ConvVariant::direct, ConvVariant::winograd2, ConvVariant::winograd4,
                                     ConvVariant::winograd4x1};

// A few: the least of them counts.
constexpr int kTuningRuns = 5;

std::optional<ConvVariant> variant_of(std::string_view word) {
  for (ConvVariant variant : kVariants)
    if (word == name(variant)) return variant;
  return {};
}

std::string checksum(std::string_view text) {
  uint64_t hash = 0xcbf29ce484222325u;  // FNV-1a
  for (char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  std::ostringstream out;
  out << std::hex << hash;
  return out.str();
}

// A CPU device works in this process: its processor time, which other work on the machine disturbs least. Else the wall's.
double now(engine::DeviceType type) {
  if (type == engine::DeviceType::cpu) return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// A layer in every variant; weights are not packed yet.
std::vector<internal::ConvStep> steps_of(const ConvShape& shape, const engine::Context& context) {
  internal::ConvStep step;
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
  std::vector<internal::ConvStep> steps;
  for (ConvVariant variant : kVariants) {
    step.variant = variant;
    step.fused = internal::can_fuse(step, context);
    step.reduced = shape.last && internal::can_reduce(step);
    step.whole_map = true;
    steps.push_back(step);
  }
  return steps;
}

// As the finest levels have it, with rows of whole vec4.
internal::MapPlace place_of(const internal::ConvStep& step) {
  const uint32_t width = step.out.width, height = step.out.height, pitch = (width + 3) / 4 * 4;
  return {0, pitch, pitch * height, 0, 0, width, height};
}

struct Kernels {
  Kernels(const std::shared_ptr<const engine::Context>& context, std::span<const internal::ConvStep> steps, Precision precision)
      : convolutions(context, steps, internal::can_shuffle(context->info()), precision), maps(context, precision) {}
  internal::ConvKernels convolutions;
  internal::FeatureMaps maps;
};

// A layer in every variant, ready to be run. Input, output and tiles are the same memory for all.
class Trial {
 public:
  Trial(const std::shared_ptr<const engine::Context>& context, const Kernels& kernels, const ConvShape& shape)
      : type_(context->info().type) {
    const size_t in = static_cast<size_t>(shape.in), out = static_cast<size_t>(shape.out);
    const ConvLayer layer{shape.in, shape.out, shape.dilation, std::vector<float>(9 * in * out, 1e-3f),
                          std::vector<float>(out, 0.1f)};
    internal::PackedWeights packed;
    std::vector<internal::ConvStep> steps = steps_of(shape, *context);
    uint64_t tiles = 1;
    for (internal::ConvStep& step : steps) {
      step.packed = packed.add(layer, step.variant);
      tiles = std::max(tiles, internal::ConvKernels::scratch_texels(step, *context));
    }
    const internal::ConvStep& step = steps.front();
    engine::MemoryPlan plan;
    const auto add = [&](const char* what, uint64_t texels, engine::BufferUse use, Precision precision = Precision::fp32) {
      return plan.add(what, internal::texel_bytes(precision) * texels, engine::MemoryKind::device, use,
                      internal::texel_format(precision));
    };
    using Uses = internal::ConvKernels;
    // A reduced output and the sums behind it are smaller than a whole one, but not at a pixel or two.
    const uint64_t texel = internal::texel_bytes(shape.precision),
                   reduced = shape.last ? internal::channel_sums(step, shape.precision).bytes(1) / texel + 1 : 0;
    const auto x = add("tuning: input", std::max(step.in.texels(), step.half.texels()), Uses::kActivations, shape.precision),
               y = add("tuning: output", std::max(step.out.texels(), reduced), Uses::kActivations, shape.precision),
               w = add("tuning: weights", packed.data().size() / 4, Uses::kWeights),
               scratch = add("tuning: tiles", tiles, Uses::kScratch),
               map = plan.add("tuning: map", 4ull * place_of(step).stride, engine::MemoryKind::device,
                              engine::BufferUse::storage);
    memory_.emplace(context, plan);
    internal::write_buffer(context, (*memory_)[w], packed.data());
    engine::ArenaSize size;
    kernels.convolutions.add_to(size);
    kernels.maps.add_to(size, 1);
    arena_.emplace(context, size);
    engine::Submission fill(context);
    engine::Recorder recorder(*context, fill.begin(), *arena_);
    // 0.5: denormals and NaN have times of their own.
    recorder.fill((*memory_)[x], shape.precision == Precision::fp16 ? 0x38003800u : 0x3f000000u);
    fill.end();
    fill.submit_and_wait();
    for (const internal::ConvStep& s : steps) {
      engine::Submission& submission = submissions_.emplace_back(context);
      engine::Recorder recorder(*context, submission.begin(), *arena_);
      if (s.fused) kernels.convolutions.record_start(recorder, (*memory_)[scratch]);
      const internal::MapPlace place = place_of(s);
      const internal::MapPart part{&(*memory_)[map], 0, 1, 0};
      kernels.convolutions.record(recorder, s, (*memory_)[x], (*memory_)[w], (*memory_)[y], (*memory_)[scratch], place,
                                  std::span(&part, 1));
      if (shape.last && !internal::writes_map(s)) kernels.maps.record(recorder, s, (*memory_)[y], (*memory_)[x], place, part);
      submission.end();
    }
  }

  // The first run of each, which compiles, does not count. They take turns, so that what else the machine does for a while
  // falls on all of them.
  std::vector<LayerTimes::Way> times(int repetitions) {
    std::array<std::vector<double>, std::size(kVariants)> seconds;
    for (engine::Submission& submission : submissions_) submission.submit_and_wait();
    for (int run = 0; run < repetitions; ++run)
      for (size_t i = 0; i < seconds.size(); ++i) {
        const double begin = now(type_);
        submissions_[i].submit_and_wait();
        seconds[i].push_back(now(type_) - begin);
      }
    std::vector<LayerTimes::Way> ways;
    for (size_t i = 0; i < seconds.size(); ++i) {
      std::sort(seconds[i].begin(), seconds[i].end());
      ways.push_back({kVariants[i], seconds[i][seconds[i].size() / 2], seconds[i].front()});
    }
    return ways;
  }

 private:
  engine::DeviceType type_;
  std::optional<engine::Workspace> memory_;
  std::optional<engine::DescriptorArena> arena_;
  std::deque<engine::Submission> submissions_;
};

}  // namespace

const char* name(ConvVariant variant) {
  constexpr const char* names[] = {"direct", "winograd2", "winograd4", "winograd4x1"};
  return names[static_cast<int>(variant)];
}

ConvVariant Tuning::choose(const ConvShape& shape) const {
  if (const auto found = variants.find(shape); found != variants.end()) return found->second;
  return shape.in >= 8 && shape.out >= 8 ? ConvVariant::winograd4 : ConvVariant::direct;
}

std::string Tuning::text(std::string_view key) const {
  std::ostringstream out;
  out << kHeader << "\n" << key << "\n" << variants.size() << "\n";
  for (const auto& [s, variant] : variants)
    out << s.in << " " << s.out << " " << s.dilation << " " << s.width << " " << s.height << " " << name(s.precision) << " "
        << s.last << " " << name(variant) << "\n";
  const std::string body = out.str();
  return body + checksum(body) + "\n";
}

std::optional<Tuning> Tuning::parse(std::string_view text, std::string_view key) {
  std::istringstream in{std::string(text)};
  std::string line, precision, word;
  if (!std::getline(in, line) || line != kHeader || !std::getline(in, line) || line != key) return {};
  Tuning tuning;
  size_t count = 0;
  if (!(in >> count)) return {};
  for (size_t i = 0; i < count; ++i) {
    ConvShape s;
    if (!(in >> s.in >> s.out >> s.dilation >> s.width >> s.height >> precision >> s.last >> word)) return {};
    s.precision = precision == name(Precision::fp16) ? Precision::fp16 : Precision::fp32;  // the checksum knows of any other
    const auto variant = variant_of(word);
    if (!variant) return {};
    tuning.variants[s] = *variant;
  }
  if (tuning.text(key) != text) return {};  // the checksum, and anything after it
  return tuning;
}

std::string tuning_key(const engine::Context& context) {
  std::ostringstream out;
  out << engine::uuid_text(context.info().uuid) << "-" << std::hex << context.info().driver_version << "-"
      << internal::conv_shader_hash() << (internal::can_shuffle(context.info()) ? "" : "-plain");
  return out.str();
}

std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels, Precision precision) {
  levels = std::min(levels, model.levels());
  const internal::Tiling tiling(model, static_cast<uint32_t>(width), static_cast<uint32_t>(height), levels, precision);
  std::set<ConvShape> shapes;
  for (int l = 0; l < levels; ++l)
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(l)])
      shapes.insert({layer.in, layer.out, layer.dilation, static_cast<int>(tiling.width >> l),
                     static_cast<int>(tiling.height >> l), precision, &layer == &model.encoder[static_cast<size_t>(l)].back()});
  return {shapes.begin(), shapes.end()};
}

const LayerTimes::Way& LayerTimes::fastest() const {
  return *std::min_element(ways.begin(), ways.end(), [](const Way& a, const Way& b) { return a.least < b.least; });
}

std::vector<LayerTimes> time_layers(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes,
                                    int repetitions, const std::function<void(int, int)>& progress) {
  std::map<Precision, std::vector<internal::ConvStep>> steps;
  for (const ConvShape& shape : shapes)
    for (const internal::ConvStep& step : steps_of(shape, *context)) steps[shape.precision].push_back(step);
  std::map<Precision, Kernels> kernels;
  for (const auto& [precision, needed] : steps) kernels.try_emplace(precision, context, needed, precision);
  std::vector<LayerTimes> times;
  for (const ConvShape& shape : shapes) {
    if (progress) progress(static_cast<int>(times.size()), static_cast<int>(shapes.size()));
    times.push_back({shape, Trial(context, kernels.at(shape.precision), shape).times(repetitions)});
  }
  return times;
}

Tuning tune(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes, Tuning known,
            const std::function<void(int, int)>& progress) {
  std::vector<ConvShape> missing;
  for (const ConvShape& shape : shapes)
    if (!known.variants.contains(shape)) missing.push_back(shape);
  if (missing.empty()) return known;
  for (const LayerTimes& layer : time_layers(context, missing, kTuningRuns, progress))
    known.variants[layer.shape] = layer.fastest().variant;
  return known;
}

}  // namespace iclk
