// Images that are encoded in tiles: where they are cut, and that it cannot be seen in the maps.
#include <cmath>
#include <random>

#include <iclk/align/network/layer_times.h>
#include <iclk/align/network/network.h>
#include <iclk/engine/error.h>

#include "device_encoder.h"
#include "plain_network.h"
#include "random_model.h"

namespace iclk {
namespace {

using internal::ConvShape;
using internal::ConvVariant;
using internal::Tiling;

uint64_t bytes_of(const Model& model, uint32_t width, uint32_t height, int levels) {
  return 16 * internal::most_texels(internal::encoder_tensors(model, width, height, levels));
}

// Along one axis, of an image of `size` pixels.
void check_spans(const std::vector<Tiling::Span>& spans, uint32_t tile, uint32_t size, uint32_t margin, uint32_t grid) {
  EXPECT_EQ(tile % grid, size % grid);
  uint32_t done = 0;
  for (const Tiling::Span& span : spans) {
    EXPECT_EQ(span.origin % grid, 0u);
    EXPECT_EQ(span.begin, done);
    EXPECT_EQ(span.begin % grid, 0u);
    EXPECT_LT(span.begin, span.end);
    EXPECT_LE(span.origin + tile, size);
    EXPECT_GE(span.begin, span.origin + (span.origin > 0 ? margin : 0));
    // The coarsest pixels of a tile end where its size, floored, does.
    const uint32_t last = span.origin + tile == size ? size : span.origin + tile / grid * grid - margin;
    EXPECT_LE(span.end, last);
    done = span.end;
  }
  EXPECT_EQ(done, size);
}

TEST(Tiling, TilesFitAndCoverTheImage) {
  // Three layers a level, dilations 1, 2, 2: 5 pixels a level and half of what came before: 5, 8, 9, 10, 10.
  const Model model = test::random_model({{4, 4, 4}, {4, 4, 4}, {4, 4, 4}, {4, 4, 4}, {4, 4, 4}});
  constexpr uint32_t margins[] = {5, 16, 36, 80, 160};
  std::mt19937 random(2);
  for (int i = 0; i < 300; ++i) {
    const int levels = 1 + static_cast<int>(random() % 5);
    const uint32_t grid = 1u << (levels - 1), margin = (margins[levels - 1] + grid - 1) / grid * grid;
    const uint32_t width = 2 * margin + 3 * grid + random() % 2000, height = 2 * margin + 3 * grid + random() % 2000;
    const uint64_t least = bytes_of(model, 2 * margin + 2 * grid, 2 * margin + 2 * grid, levels),
                   whole = bytes_of(model, width, height, levels);
    const uint64_t limit = least + random() % (whole + 1);
    const Tiling tiling(model, width, height, levels, limit);
    SCOPED_TRACE(testing::Message() << width << "x" << height << " in " << levels << " levels, " << tiling.columns.size() << "x"
                                    << tiling.rows.size() << " of " << tiling.width << "x" << tiling.height);
    check_spans(tiling.columns, tiling.width, width, margin, grid);
    check_spans(tiling.rows, tiling.height, height, margin, grid);
    EXPECT_LE(bytes_of(model, tiling.width, tiling.height, levels), limit);
    EXPECT_EQ(tiling.columns.size() * tiling.rows.size() == 1, whole <= limit);
  }
}

TEST(Tiling, WhatCannotBeCutIsRefused) {
  const Model model = test::random_model({{4, 4, 4}, {4, 4, 4}, {4, 4, 4}, {4, 4, 4}});
  // Narrower than two margins and a pixel: there is no cut across, and down the smallest tile is too much.
  try {
    Tiling(model, 160, 4000, 4, 400'000);
    ADD_FAILURE() << "taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unsupported);
    EXPECT_NE(std::string(error.what()).find("160x4000"), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("margins of 80"), std::string::npos) << error.what();
  }
  EXPECT_GT(Tiling(model, 160, 4000, 4, 1'000'000).rows.size(), 1u);
}

TEST(Tiling, MeasuredShapesAreThoseOfTheTiles) {
  Model model = test::random_model({{32, 32}, {64, 64}});
  const Tiling tiling(model, 1500, 1101, 2);
  EXPECT_EQ(tiling.columns.size() * tiling.rows.size(), 2u);
  const auto shapes = internal::encoder_shapes(model, 1500, 1101, 2);
  ASSERT_EQ(shapes.size(), 4u);
  for (const ConvShape& shape : shapes) {
    const uint32_t level = shape.out == 64;
    EXPECT_EQ(static_cast<uint32_t>(shape.width), tiling.width >> level);
    EXPECT_EQ(static_cast<uint32_t>(shape.height), tiling.height >> level);
  }
}

struct Case {
  ConvVariant variant;
  int levels, width, height;
  uint32_t tile;  // a square of such a side fits
  size_t columns, rows;
};
void PrintTo(const Case& c, std::ostream* out) {
  *out << name(c.variant) << "_" << c.levels << "levels_" << c.width << "x" << c.height;
}

class TiledEncoder : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};

TEST_P(TiledEncoder, GivesTheMapsOfTheWholeImage) {
  const Case c = GetParam();
  const std::shared_ptr<const Model> model =
      c.levels < 5 ? test::odd_model()
                   : std::make_shared<Model>(test::random_model({{4, 4, 4}, {5, 5, 5}, {8, 8, 8}, {9, 9, 9}, {4, 4, 8}}));
  test::DeviceEncoder encoder(model, c.width, c.height, c.levels, PixelFormat::rgba8);
  encoder.most_bytes = bytes_of(*model, c.tile, c.tile, c.levels);
  encoder.variant = c.variant;
  const Tiling tiling = encoder.tiling();
  ASSERT_EQ(tiling.columns.size(), c.columns) << tiling.width;
  ASSERT_EQ(tiling.rows.size(), c.rows) << tiling.height;

  std::mt19937 random(4);
  std::vector<std::vector<uint8_t>> images(3);
  for (auto& image : images)
    for (int i = 0; i < 3 * c.width * c.height; ++i) image.push_back(static_cast<uint8_t>(random()));
  const auto maps = encoder.encode(images, 2);
  const auto last = encoder.encode({images[2]}, 1);
  const size_t stride = encoder.layout.map_stride;
  for (size_t i = 0; i < images.size(); ++i) {
    const Pyramid expected = internal::encode(*model, {images[i].data(), c.width, c.height, 0, PixelFormat::rgb8}, c.levels);
    for (size_t l = 0; l < expected.size(); ++l) {
      const auto& info = encoder.layout.levels[l];
      float largest = 0;
      for (const float x : expected[l].data) largest = std::max(largest, std::abs(x));
      for (uint32_t v = 0; v < info.height; ++v)
        for (uint32_t u = 0; u < info.width; ++u) {
          const size_t at = info.map_offset + v * info.pitch + u;
          ASSERT_NEAR(maps[i * stride + at], expected[l].at(static_cast<int>(u), static_cast<int>(v)), 1e-4 * largest)
              << "image " << i << " level " << l << " at " << u << ", " << v;
          if (i == 2) {
            ASSERT_EQ(maps[i * stride + at], last[at]) << "level " << l << " at " << u << ", " << v;
          }
        }
    }
  }
}

// Margins are 56 pixels of odd_model and 160 of five levels.
INSTANTIATE_TEST_SUITE_P(
    Variants, TiledEncoder,
    testing::Values(Case{ConvVariant::direct, 4, 301, 277, 200, 3, 2}, Case{ConvVariant::winograd4, 4, 301, 203, 170, 4, 2},
                    Case{ConvVariant::winograd4, 4, 184, 279, 150, 3, 4}, Case{ConvVariant::winograd4, 2, 150, 97, 60, 4, 2},
                    Case{ConvVariant::winograd4, 1, 61, 90, 40, 2, 3}, Case{ConvVariant::winograd4, 5, 493, 450, 402, 2, 2},
                    Case{ConvVariant::direct, 5, 358, 421, 380, 1, 2}, Case{ConvVariant::winograd4, 4, 301, 277, 200, 3, 2},
                    Case{ConvVariant::winograd4x1, 4, 301, 277, 200, 3, 2}),
    [](const auto& info) { return testing::PrintToString(info.param); });

}  // namespace
}  // namespace iclk
