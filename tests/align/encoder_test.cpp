// The encoder on the device against a plain one.
#include <gtest/gtest.h>

#include <memory>

#include <iclk/align/internal/encoder.h>
#include <iclk/align/internal/upload.h>

#include "device.h"
#include "plain_network.h"
#include "read_back.h"

namespace iclk {
namespace {

struct Case {
  ConvVariant variant;
  bool shuffle;
  PixelFormat format;
  int input_channels;
  int width, height, levels;
};
std::string text(const Case& c) {
  return name(c.variant) + std::string(c.shuffle ? "" : "_plain") + "_format" + std::to_string(static_cast<int>(c.format)) +
         "_" + std::to_string(c.input_channels) + "channels_" + std::to_string(c.width) + "x" + std::to_string(c.height) + "_" +
         std::to_string(c.levels) + "levels";
}
void PrintTo(const Case& c, std::ostream* out) { *out << text(c); }

class EncoderDevice : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }

  // Maps of all images that `images` holds (rgb8), in passes of up to `pass` images.
  std::vector<float> encode(const std::vector<std::vector<uint8_t>>& images, uint32_t pass) {
    const Case c = GetParam();
    const auto context = test::device();
    const auto n = static_cast<uint32_t>(images.size());
    engine::MemoryPlan memory_plan;
    const uint64_t image_bytes = 4ull * layout->pixel_words;
    const auto pixels = memory_plan.add("pixels", image_bytes * n, engine::MemoryKind::upload, engine::BufferUse::storage);
    const auto maps = memory_plan.add("maps", 4ull * layout->map_stride * n, engine::MemoryKind::device,
                                      engine::BufferUse::storage | engine::BufferUse::texel, VK_FORMAT_R32_SFLOAT);
    Tuning tuning;
    for (const ConvShape& shape : encoder_shapes(*model, c.width, c.height, c.levels)) tuning.variants[shape] = c.variant;
    internal::Encoder encoder(*context, model, *layout, plan, pass, memory_plan, tuning);
    EXPECT_EQ(encoder.images_per_pass(), pass);
    const engine::Workspace memory(context, memory_plan);
    encoder.load(context, memory, c.shuffle);
    for (uint32_t i = 0; i < n; ++i)
      internal::convert_pixels({images[i].data(), c.width, c.height, 0, PixelFormat::rgb8}, c.format, layout->row_pixels(),
                               static_cast<uint8_t*>(memory[pixels].mapped) + image_bytes * i);
    engine::ArenaSize size;
    encoder.add_to(size, 1);
    engine::DescriptorArena arena(context, size);
    engine::Submission submission(context);
    engine::Recorder recorder(*context, submission.begin(), arena);
    encoder.record(recorder, memory, memory[pixels], memory[maps], 0, n);
    submission.end();
    submission.submit_and_wait();
    return test::read_back(memory[maps]);
  }

  std::shared_ptr<const Model> model = test::odd_model(GetParam().input_channels);
  Plan plan;
  std::unique_ptr<internal::Layout> layout;
};

TEST_P(EncoderDevice, IsThePlainOneInEveryBatch) {
  const Case c = GetParam();
  if (c.shuffle && !internal::can_shuffle(test::device()->info())) GTEST_SKIP() << "no subgroup shuffles here";
  plan.width = c.width;
  plan.height = c.height;
  plan.format = c.format;
  AlignerOptions options;
  options.levels = c.levels;
  layout = std::make_unique<internal::Layout>(plan, options, model.get());
  ASSERT_FALSE(layout->level0_in_pixels);

  std::mt19937 random(3);
  std::vector<std::vector<uint8_t>> images(3);
  for (auto& image : images)
    for (int i = 0; i < 3 * c.width * c.height; ++i) image.push_back(static_cast<uint8_t>(random()));
  const auto together = encode(images, 3), in_two = encode(images, 2);
  const bool grey = c.format == PixelFormat::r8 || c.format == PixelFormat::r32f;
  for (size_t i = 0; i < images.size(); ++i) {
    const auto alone = encode({images[i]}, 1);
    test::PlainMaps x(c.width, c.height, c.input_channels);
    for (int v = 0; v < c.height; ++v)
      for (int u = 0; u < c.width; ++u) {
        const uint8_t* p = &images[i][static_cast<size_t>(3 * (v * c.width + u))];
        double luma = (0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]) / 255;
        if (c.format == PixelFormat::r8) luma = std::round(255 * luma) / 255;
        for (int k = 0; k < c.input_channels; ++k) x.at(k, v, u) = grey || c.input_channels == 1 ? luma : p[k] / 255.0;
      }
    const auto expected = test::encode(*model, x, c.levels);
    for (size_t l = 0; l < expected.size(); ++l) {
      const auto& info = layout->levels[l];
      ASSERT_EQ(info.width, static_cast<uint32_t>(expected[l].width));
      for (uint32_t v = 0; v < info.height; ++v)
        for (uint32_t u = 0; u < info.width; ++u) {
          const size_t at = info.map_offset + v * info.pitch + u;
          ASSERT_NEAR(alone[at], expected[l].at(0, static_cast<int>(v), static_cast<int>(u)), 2e-5)
              << "image " << i << " level " << l << " at " << u << ", " << v;
          ASSERT_EQ(together[i * layout->map_stride + at], alone[at]) << "image " << i << " level " << l;
          ASSERT_EQ(in_two[i * layout->map_stride + at], alone[at]) << "image " << i << " level " << l;
        }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Variants, EncoderDevice,
                         testing::Values(Case{ConvVariant::direct, true, PixelFormat::rgba8, 3, 61, 37, 4},
                                         Case{ConvVariant::direct, false, PixelFormat::bgra8, 1, 61, 37, 3},
                                         Case{ConvVariant::winograd2, true, PixelFormat::r8, 3, 40, 24, 4},
                                         Case{ConvVariant::winograd2, false, PixelFormat::rgba32f, 3, 17, 45, 2},
                                         Case{ConvVariant::winograd4, true, PixelFormat::r32f, 1, 83, 30, 3},
                                         Case{ConvVariant::winograd4, false, PixelFormat::bgra8, 3, 31, 29, 4},
                                         Case{ConvVariant::winograd4, true, PixelFormat::rgba32f, 1, 8, 9, 1}),
                         [](const auto& info) { return text(info.param); });

}  // namespace
}  // namespace iclk
