#pragma once
#include <memory>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include <iclk/align/device/upload.h>
#include <iclk/align/network/encoder.h>

#include "read_back.h"

namespace iclk::test {

/// What an encoder is made of, and the layout of its maps.
struct DeviceEncoder {
  std::shared_ptr<const Model> model;
  Plan plan;
  internal::Layout layout;
  std::shared_ptr<engine::Context> context = device();
  uint64_t most_bytes = internal::kActivationBytes;
  std::optional<internal::ConvVariant> variant;  ///< of every layer

  DeviceEncoder(std::shared_ptr<const Model> m, int width, int height, int levels, PixelFormat format)
      : model(std::move(m)), plan(plan_of(width, height, format)), layout(plan, options_of(levels), model.get()) {}

  int levels() const { return static_cast<int>(layout.levels.size()); }
  internal::Tiling tiling() const { return {*model, layout.levels[0].width, layout.levels[0].height, levels(), most_bytes}; }
  /// Maps of all images, in passes of `pass` images; the last `last` of them are recorded after the first one, as if they lay
  /// elsewhere. Precondition: `last` is less than their number.
  std::vector<float> encode(const std::vector<ImageView>& images, uint32_t pass, uint32_t last = 0) const {
    const auto n = static_cast<uint32_t>(images.size());
    engine::MemoryPlan memory_plan;
    const uint64_t image_bytes = 4ull * layout.pixel_words;
    const auto pixels =
        memory_plan.add("pixels", image_bytes * n, engine::MemoryKind::upload,
                        engine::BufferUse::storage | engine::BufferUse::texel, internal::texel_format(plan.format));
    const auto maps = memory_plan.add("maps", 4ull * layout.map_stride * n, engine::MemoryKind::device,
                                      engine::BufferUse::storage | engine::BufferUse::texel, VK_FORMAT_R32_SFLOAT);
    internal::Encoder encoder(*context, model, layout, plan, pass, memory_plan, variant, most_bytes);
    EXPECT_EQ(encoder.images_per_pass(), pass);
    const engine::Workspace memory(context, memory_plan);
    encoder.load(context, memory);
    for (uint32_t i = 0; i < n; ++i)
      internal::convert_pixels(images[i], plan.format, layout.row_pixels(),
                               static_cast<uint8_t*>(memory[pixels].mapped) + image_bytes * i);
    engine::ArenaSize size;
    encoder.add_to(size, 1);
    engine::DescriptorArena arena(context, size);
    engine::Submission submission(context);
    engine::Recorder recorder(*context, submission.begin(), arena);
    recorder.fill(memory[maps], 0x7fc00000u);  // what is not written is no number
    const internal::Encoder::Images all[] = {{&memory[pixels], &memory[maps], 0, 1},
                                             {&memory[pixels], &memory[maps], n - last, last},
                                             {&memory[pixels], &memory[maps], 1, n - last - 1}};
    encoder.record(recorder, memory, all);
    submission.end();
    submission.submit_and_wait();
    return read_back(memory[maps], context);
  }
  std::vector<float> encode(const std::vector<std::vector<uint8_t>>& rgb8, uint32_t pass, uint32_t last = 0) const {
    std::vector<ImageView> images;
    for (const auto& image : rgb8) images.push_back({image.data(), plan.width, plan.height, 0, PixelFormat::rgb8});
    return encode(images, pass, last);
  }

 private:
  static Plan plan_of(int width, int height, PixelFormat format) {
    Plan plan{width, height};
    plan.format = format;
    return plan;
  }
  static AlignerOptions options_of(int levels) {
    AlignerOptions options;
    options.levels = levels;
    return options;
  }
};

}  // namespace iclk::test
