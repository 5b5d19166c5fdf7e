// The encoder on the device against a plain one.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include <iclk/align/network/network.h>

#include "device_encoder.h"
#include "plain_network.h"

namespace iclk {
namespace {

using internal::ConvVariant;

struct Case {
  ConvVariant variant;
  bool shuffle;
  PixelFormat format;
  int input_channels;
  int width, height, levels;
  Normalisation normalisation = Normalisation::fixed;
};
constexpr Normalisation by_image = Normalisation::image;
std::string text(const Case& c) {
  return name(c.variant) + std::string(c.shuffle ? "" : "_plain") + "_format" + std::to_string(static_cast<int>(c.format)) +
         "_" + std::to_string(c.input_channels) + "channels_" + std::to_string(c.width) + "x" + std::to_string(c.height) + "_" +
         std::to_string(c.levels) + "levels" + (c.normalisation == Normalisation::image ? "_by_image" : "");
}
void PrintTo(const Case& c, std::ostream* out) { *out << text(c); }

class EncoderDevice : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};

TEST_P(EncoderDevice, IsThePlainOneInEveryBatch) {
  const Case c = GetParam();
  const auto model = test::odd_model(c.input_channels);
  model->normalisation = c.normalisation;
  test::DeviceEncoder encoder(model, c.width, c.height, c.levels, c.format);
  if (!c.shuffle) encoder.context = test::device_without_subgroups();
  encoder.variant = c.variant;
  ASSERT_FALSE(encoder.layout.level0_in_pixels);

  std::mt19937 random(3);
  std::vector<std::vector<uint8_t>> images(3);
  for (auto& image : images)
    for (int i = 0; i < 3 * c.width * c.height; ++i) image.push_back(static_cast<uint8_t>(random()));
  // Three sources: in two passes of two images, and in one that has room for all of them.
  const auto together = encoder.encode(images, 3), in_two = encoder.encode(images, 2), in_parts = encoder.encode(images, 2, 1),
             in_three = encoder.encode(images, 3, 1);
  const bool grey = c.format == PixelFormat::r8 || c.format == PixelFormat::r32f;
  for (size_t i = 0; i < images.size(); ++i) {
    const auto alone = encoder.encode({images[i]}, 1);
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
      const auto& info = encoder.layout.levels[l];
      ASSERT_EQ(info.width, static_cast<uint32_t>(expected[l].width));
      for (uint32_t v = 0; v < info.height; ++v)
        for (uint32_t u = 0; u < info.width; ++u) {
          const size_t at = info.map_offset + v * info.pitch + u;
          ASSERT_NEAR(alone[at], expected[l].at(0, static_cast<int>(v), static_cast<int>(u)), 2e-5)
              << "image " << i << " level " << l << " at " << u << ", " << v;
          ASSERT_EQ(together[i * encoder.layout.map_stride + at], alone[at]) << "image " << i << " level " << l;
          ASSERT_EQ(in_two[i * encoder.layout.map_stride + at], alone[at]) << "image " << i << " level " << l;
          ASSERT_EQ(in_parts[i * encoder.layout.map_stride + at], alone[at]) << "image " << i << " level " << l;
          ASSERT_EQ(in_three[i * encoder.layout.map_stride + at], alone[at]) << "image " << i << " level " << l;
        }
    }
  }
}

// Pixels that are no numbers spoil what they can be seen from, not the image's mean and deviation.
TEST(EncoderByImage, HolesAreNoPartOfTheLight) {
  ICLK_NEED_DEVICE();
  const auto model = test::odd_model(3);
  model->normalisation = Normalisation::image;
  test::DeviceEncoder encoder(model, 90, 40, 1, PixelFormat::rgba32f);
  encoder.variant = ConvVariant::direct;
  std::mt19937 random(4);
  std::vector<float> pixels;
  for (int i = 0; i < 3 * 90 * 40; ++i) pixels.push_back(static_cast<float>(random() % 256) / 255);
  pixels[0] = NAN, pixels[4] = 3e38f, pixels[8] = -std::numeric_limits<float>::infinity();
  const ImageView image{pixels.data(), 90, 40, 0, PixelFormat::rgb32f};
  const auto maps = encoder.encode(std::vector{image}, 1);
  const Map expected = internal::encode(*model, image, 1).front();
  const auto& info = encoder.layout.levels[0];
  for (int v = 0; v < 40; ++v)
    for (int u = 20; u < 90; ++u)
      ASSERT_NEAR(maps[info.map_offset + static_cast<uint32_t>(v) * info.pitch + static_cast<uint32_t>(u)], expected.at(u, v),
                  2e-5)
          << u << ", " << v;
}

INSTANTIATE_TEST_SUITE_P(Variants, EncoderDevice,
                         testing::Values(Case{ConvVariant::direct, true, PixelFormat::rgba8, 3, 61, 37, 4},
                                         Case{ConvVariant::direct, false, PixelFormat::bgra8, 1, 61, 37, 3, by_image},
                                         Case{ConvVariant::winograd4, true, PixelFormat::r8, 3, 40, 24, 4, by_image},
                                         Case{ConvVariant::winograd4x1, true, PixelFormat::rgba32f, 3, 17, 45, 2},
                                         Case{ConvVariant::winograd4, true, PixelFormat::r32f, 1, 83, 30, 3},
                                         Case{ConvVariant::winograd4x1, true, PixelFormat::bgra8, 3, 31, 29, 4, by_image},
                                         Case{ConvVariant::winograd4, true, PixelFormat::rgba32f, 1, 8, 9, 1},
                                         Case{ConvVariant::winograd4, true, PixelFormat::rgba32f, 3, 53, 47, 4, by_image},
                                         Case{ConvVariant::winograd4x1, true, PixelFormat::r8, 1, 29, 64, 2},
                                         Case{ConvVariant::winograd4x1, true, PixelFormat::rgba8, 3, 71, 33, 3, by_image},
                                         Case{ConvVariant::direct, true, PixelFormat::rgba32f, 3, 67, 41, 2, by_image}),
                         [](const auto& info) { return text(info.param); });

}  // namespace
}  // namespace iclk
