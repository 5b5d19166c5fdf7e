#include <iclk/align/network/encoder.h>

#include <algorithm>

#include "image_light.comp.spv.h"
#include "image_moments.comp.spv.h"
#include "normalise.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kLanes = 64;
// The activations of one pass. More images at a time use a large device better, but need more memory.
constexpr uint64_t kPassBytes = 192ull << 20;

}  // namespace

Encoder::Encoder(const engine::Context& context, std::shared_ptr<const Model> model, const Layout& layout, const Plan& plan,
                 uint32_t most_images, engine::MemoryPlan& memory, std::optional<ConvVariant> variant, uint64_t most_bytes)
    : model_(std::move(model)),
      format_(plan.format),
      normalising_(context.info().type == engine::DeviceType::cpu ? Normalising{8, 20} : Normalising{64, 4}),
      row_pixels_(layout.row_pixels()),
      pixel_words_(layout.pixel_words),
      map_stride_(layout.map_stride),
      tiling_(*model_, layout.levels[0].width, layout.levels[0].height, static_cast<int>(layout.levels.size()), most_bytes) {
  const auto tensors = encoder_tensors(*model_, tiling_.width, tiling_.height, static_cast<int>(layout.levels.size()));
  uint64_t weights = 0, scratch = 1;
  for (size_t l = 0; l < tensors.size(); ++l) {
    Level level;
    level.info = layout.levels[l];
    for (size_t i = 0; i < model_->encoder[l].size(); ++i) {
      const ConvLayer& layer = model_->encoder[l][i];
      ConvStep step;
      step.in = tensors[l][i];
      step.out = tensors[l][i + 1];
      step.dilation = static_cast<uint32_t>(layer.dilation);
      const bool last = i + 1 == model_->encoder[l].size();
      const ConvShape shape{
          layer.in, layer.out, layer.dilation, static_cast<int>(step.in.width), static_cast<int>(step.in.height), last};
      step.variant = variant.value_or(choose_variant(shape, context.info().type));
      if (context.storage_reads() || !has_kernel(step, context)) step.variant = ConvVariant::direct;
      if (last && l + 1 < tensors.size()) step.half = tensors[l + 1].front();
      step.fused = can_fuse(step, context);
      step.reduced = last && can_reduce(step);
      step.whole_map = writes_map(step);
      for (const Tiling::Span& row : tiling_.rows)
        for (const Tiling::Span& column : tiling_.columns)
          step.whole_map = step.whole_map && map_place(level.info, l, column, row).whole(step.out.width);
      weights += packed_texels(layer, step.variant);
      level.steps.push_back(step);
      TensorLayout& border = level.borders[i % 2];
      if (step.in.channels > border.channels) border = step.in;
    }
    const ConvStep& last = level.steps.back();
    TensorLayout& border = level.borders[level.steps.size() % 2];
    if (!last.reduced && last.out.channels > border.channels) border = last.out;
    levels_.push_back(std::move(level));
  }
  const auto texels = activation_texels();
  pass_ = static_cast<uint32_t>(std::clamp<uint64_t>(std::min(kPassBytes / kTexelBytes / (texels[0] + texels[1]),
                                                              kActivationBytes / kTexelBytes / std::max(texels[0], texels[1])),
                                                     1, most_images));
  for (Level& level : levels_)
    for (ConvStep& step : level.steps) {
      step.in.images = step.out.images = pass_;
      scratch = std::max(scratch, ConvKernels::scratch_texels(step));
    }
  const auto add = [&](const char* name, uint64_t count, engine::BufferUse use = ConvKernels::kActivations) {
    return memory.add(name, kTexelBytes * count, engine::MemoryKind::device, use, kTexelFormat);
  };
  activations_[0] = add("activations, even layers", std::max<uint64_t>(texels[0], 1) * pass_);
  activations_[1] = add("activations, odd layers", std::max<uint64_t>(texels[1], 1) * pass_);
  weights_ = add("encoder weights", weights, ConvKernels::kWeights);
  scratch_ = add("transformed tiles", scratch, ConvKernels::kScratch);
  const auto storage = [&](const char* name, uint64_t floats) {
    return memory.add(name, 4 * floats * pass_, engine::MemoryKind::device, engine::BufferUse::storage);
  };
  light_ = storage("mean and deviation of images", 2);
  if (by_image()) moments_ = storage("moments of images", 4ull * ICLK_LIGHT_STRIPS * kLanes);
}

MapPlace Encoder::map_place(const shaders::LevelInfo& info, size_t level, const Tiling::Span& column,
                            const Tiling::Span& row) const {
  const auto at_level = [&](uint32_t pixels0) { return pixels0 >> level; };
  const uint32_t u = at_level(column.origin), v = at_level(row.origin);
  return {info.map_offset + v * info.pitch + u,
          info.pitch,
          map_stride_,
          at_level(column.begin) - u,
          at_level(row.begin) - v,
          at_level(column.end) - u,
          at_level(row.end) - v};
}

std::array<uint64_t, 2> Encoder::activation_texels() const {
  std::array<uint64_t, 2> texels{};
  size_t place = 0;
  const auto need = [&](uint64_t count) { texels[place % 2] = std::max(texels[place % 2], count); };
  for (const Level& level : levels_) {
    for (const ConvStep& step : level.steps) {
      need(step.in.texels());
      ++place;
    }
    const ConvStep& last = level.steps.back();
    if (writes_map(last)) {
      need(last.half.width > 0 ? last.half.texels() : 0);
    } else if (last.reduced) {
      need(channel_sums(last).texels(1));
    } else {
      need(last.out.texels());
      ++place;
    }
  }
  return texels;
}

void Encoder::load(std::shared_ptr<const engine::Context> context, const engine::Workspace& memory) {
  using enum engine::BindingKind;
  std::vector<ConvStep> steps;
  PackedWeights packed;
  for (size_t l = 0; l < levels_.size(); ++l)
    for (size_t i = 0; i < levels_[l].steps.size(); ++i) {
      ConvStep& step = levels_[l].steps[i];
      step.packed = packed.add(model_->encoder[l][i], step.variant);
      steps.push_back(step);
    }
  write_buffer(context, memory[weights_], packed.data());
  const uint32_t format = shader_format(format_), channels = static_cast<uint32_t>(model_->input_channels);
  if (by_image()) {
    image_moments_ = {context,
                      {"encode",
                       image_moments_comp_spv,
                       {texel_read, storage_write},
                       sizeof(shaders::MomentsPush),
                       {kLanes, format, channels}}};
    image_light_ = {context, {"encode", image_light_comp_spv, {storage_read, storage_write}, 0, {kLanes}}};
  }
  normalise_ = {context,
                {"encode",
                 normalise_comp_spv,
                 {texel_read, storage_write, storage_read},
                 sizeof(shaders::NormalisePush),
                 {normalising_.lanes, format, channels, by_image(), normalising_.pixels}}};
  convolutions_.emplace(context, steps);
  feature_maps_.emplace(context);
}

void Encoder::record(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Images> all) const {
  recorder.stage("encode");
  std::vector<Part> parts;  // of the next pass
  uint32_t filled = 0;
  const auto pass = [&] {
    if (by_image()) record_light(recorder, memory, parts);
    for (const Tiling::Span& row : tiling_.rows)
      for (const Tiling::Span& column : tiling_.columns) record_tile(recorder, memory, parts, column, row);
    parts.clear();
    filled = 0;
  };
  for (Images images : all)
    while (images.count > 0) {
      const uint32_t taken = std::min(images.count, pass_ - filled);
      parts.push_back({{images.pixels, images.maps, images.first, taken}, filled});
      images.first += taken;
      images.count -= taken;
      filled += taken;
      if (filled == pass_ || parts.size() == 2) pass();  // a step writes at most two parts
    }
  if (filled > 0) pass();
}

void Encoder::record_light(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Part> parts) const {
  const shaders::LevelInfo& image = levels_[0].info;
  for (const Part& part : parts) {
    const shaders::MomentsPush m{image.width, image.height, row_pixels_, pixel_words_, part.first, part.at};
    recorder.dispatch(image_moments_, {part.pixels, &memory[moments_]}, m, {1, ICLK_LIGHT_STRIPS, part.count});
  }
  recorder.dispatch(image_light_, {&memory[moments_], &memory[light_]}, {parts.back().at + parts.back().count, 1, 1});
}

void Encoder::record_tile(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Part> parts,
                          const Tiling::Span& column, const Tiling::Span& row) const {
  const uint32_t count = parts.back().at + parts.back().count;
  std::vector<MapPart> maps;
  for (const Part& part : parts) maps.push_back({part.maps, part.at, part.count, part.first});
  size_t at = 0;
  const auto buffer = [&](size_t number) -> const engine::Buffer& { return memory[activations_[number % 2]]; };
  TensorLayout input = levels_[0].steps.front().in;
  input.images = count;
  shaders::NormalisePush n{};
  n.width = input.width;
  n.height = input.height;
  n.row_pixels = row_pixels_;
  n.origin = row.origin * row_pixels_ + column.origin;
  n.pixel_stride = pixel_words_;
  n.out_offset = input.offset();
  n.out_pitch = input.pitch();
  n.out_image = input.image();
  for (size_t c = 0; c < 3; ++c) {
    n.mean[c] = model_->mean[c];
    n.inverse_std[c] = 1 / model_->std[c];
  }
  const auto record_borders = [&](const Level& level, size_t number) {
    TensorLayout first = level.borders[0], second = level.borders[1];
    first.images = second.images = count;
    convolutions_->record_borders(recorder, first, second, buffer(number), buffer(number + 1));
  };
  record_borders(levels_[0], 0);
  for (const Part& part : parts) {
    n.first_image = part.first;
    n.at = part.at;
    recorder.dispatch(normalise_, {part.pixels, &buffer(0), &memory[light_]}, n,
                      {engine::groups_for(n.width, normalising_.lanes * normalising_.pixels), n.height, part.count});
  }
  uint32_t fused = 0;
  for (size_t l = 0; l < levels_.size(); ++l) {
    const Level& level = levels_[l];
    const MapPlace place = map_place(level.info, l, column, row);
    ConvStep step;
    for (const ConvStep& each : level.steps) {
      step = each;
      if (step.fused) {
        step.counter = fused++ % ICLK_WORK_COUNTERS;
        if (step.counter == 0) convolutions_->record_start(recorder, memory[scratch_]);
      }
      step.in.images = step.out.images = step.half.images = count;
      convolutions_->record(recorder, step, buffer(at), memory[weights_], buffer(at + 1), memory[scratch_], place, maps);
      ++at;
    }
    if (!writes_map(step))
      for (const MapPart& part : maps) feature_maps_->record(recorder, step, buffer(at), buffer(at + 1), place, part);
    if (!step.reduced) ++at;
    if (l + 1 < levels_.size()) record_borders(levels_[l + 1], at);
  }
}

void Encoder::add_to(engine::ArenaSize& size, uint32_t sources) const {
  if (by_image()) {
    size.add(image_moments_, sources);
    size.add(image_light_, 1);
  }
  size.add(normalise_, sources);
  feature_maps_->add_to(size, sources);
  convolutions_->add_to(size);
}

}  // namespace iclk::internal
