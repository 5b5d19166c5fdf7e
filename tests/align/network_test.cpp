// The learned model's arithmetic on the CPU where golden files do not reach: odd sizes, any architecture, every pixel format.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/network/m_estimator.h>
#include <iclk/align/network/network.h>
#include <iclk/engine/error.h>

#include "random_model.h"

namespace iclk {
namespace {

using internal::Planes;
using test::random_layer;
using test::random_model;
using test::random_planes;

/// The definition, in double precision.
double convolved(const Planes& in, const ConvLayer& layer, int out, int u, int v) {
  double sum = layer.bias[static_cast<size_t>(out)];
  for (int c = 0; c < layer.in; ++c)
    for (int i = -1; i <= 1; ++i)
      for (int j = -1; j <= 1; ++j) {
        const int x = u + j * layer.dilation, y = v + i * layer.dilation;
        if (x >= 0 && y >= 0 && x < in.width && y < in.height)
          sum += static_cast<double>(layer.weight[static_cast<size_t>((out * layer.in + c) * 9 + (i + 1) * 3 + j + 1)]) *
                 in.row(c, y)[x];
      }
  return sum > 0 ? sum : std::expm1(sum);
}

TEST(Network, ConvolutionIsItsDefinition) {
  struct Case {
    int in, out, dilation, width, height;
  };
  for (const Case& c : std::vector<Case>{{3, 16, 1, 31, 17},
                                         {5, 7, 2, 13, 9},
                                         {1, 1, 1, 1, 1},
                                         {2, 3, 4, 3, 2},  // the dilation is larger than the image
                                         {4, 2, 64, 130, 3},
                                         {64, 96, 2, 47, 30}}) {
    const Planes in = random_planes(c.in, c.width, c.height, 3);
    const ConvLayer layer = random_layer(c.in, c.out, c.dilation, 4);
    const Planes out = internal::convolve(in, layer);
    ASSERT_EQ(out.channels, c.out);
    for (int k = 0; k < c.out; ++k)
      for (int v = 0; v < c.height; ++v)
        for (int u = 0; u < c.width; ++u)
          ASSERT_NEAR(out.row(k, v)[u], convolved(in, layer, k, u, v), 1e-5)
              << c.in << " to " << c.out << " channels, dilation " << c.dilation << ", " << c.width << "x" << c.height;
  }
}

TEST(Network, AStripOfRowsIsAsGoodAsTheWholeImage) {
  // 9 * 40 taps by 600 pixels a row: less than one row fits into the strip's memory.
  const Planes in = random_planes(40, 600, 5, 5);
  const ConvLayer layer = random_layer(40, 3, 2, 6);
  const Planes out = internal::convolve(in, layer);
  for (int v = 0; v < 5; ++v)
    for (int u = 0; u < 600; u += 7) ASSERT_NEAR(out.row(2, v)[u], convolved(in, layer, 2, u, v), 1e-5) << u << " " << v;
}

TEST(Network, MEstimatorInTilesGivesTheDenseValues) {
  const Model model = random_model({{4}});
  for (const auto& [width, height] : std::vector<std::pair<int, int>>{{203, 151}, {40, 33}, {7, 5}}) {
    const Planes in = random_planes(4, width, height, 7);
    Map visible(width, height);
    for (const auto& [u, v] : std::vector<std::pair<int, int>>{{0, 0}, {width / 2, height / 3}, {width - 5, height - 4}})
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 5; ++j) visible.at(std::min(u + j, width - 1), std::min(v + i, height - 1)) = 1;
    const Map tiles = internal::m_estimator(model, in, visible);
    Planes dense = in;
    for (const ConvLayer& layer : model.m_estimator) dense = internal::convolve(dense, layer);
    EXPECT_GT(tiles.at(0, 0), 0);
    for (size_t i = 0; i < tiles.data.size(); ++i)
      ASSERT_FLOAT_EQ(tiles.data[i], visible.data[i] > 0 ? 1 / (1 + std::exp(-dense.data[i])) : 0) << i;
  }
}

TEST(Network, FewerLevelsAreTheFinestOnes) {
  const Model model = random_model({{4, 6}, {8}, {8, 8}});
  std::vector<float> pixels(size_t{3} * 50 * 40);
  for (size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<float>(i * 7919 % 256) / 255;
  const ImageView image{pixels.data(), 50, 40, 0, PixelFormat::rgb32f};
  const Pyramid three = internal::encode(model, image, 3), two = internal::encode(model, image, 2);
  ASSERT_EQ(three.size(), 3u);
  ASSERT_EQ(two.size(), 2u);
  EXPECT_EQ(three[2].width, 12);
  EXPECT_EQ(two[0].data, three[0].data);
  EXPECT_EQ(two[1].data, three[1].data);
}

TEST(Network, EveryPixelFormatIsTheSameColours) {
  const Model model = random_model({{4}});
  const uint8_t rgb[] = {10, 200, 30, 255, 0, 128}, bgr[] = {30, 200, 10, 128, 0, 255};
  const uint8_t rgba[] = {10, 200, 30, 9, 255, 0, 128, 9}, bgra[] = {30, 200, 10, 9, 128, 0, 255, 9}, grey[] = {77, 255};
  uint16_t bgr16[6];
  float rgb32[6], rgba32[8];
  for (int i = 0; i < 6; ++i) bgr16[i] = static_cast<uint16_t>(bgr[i] * 257), rgb32[i] = static_cast<float>(rgb[i]) / 255;
  for (int i = 0; i < 8; ++i) rgba32[i] = static_cast<float>(rgba[i]) / 255;
  const auto input = [&](const Model& m, const void* data, PixelFormat format) {
    return internal::network_input(m, {data, 2, 1, 0, format});
  };
  const Planes expected = input(model, rgb, PixelFormat::rgb8);
  EXPECT_NEAR(expected.row(0, 0)[0], (10 / 255.0 - 0.49) / 0.2, 1e-5);
  EXPECT_NEAR(expected.row(1, 0)[0], (200 / 255.0 - 0.48) / 0.19, 1e-5);
  EXPECT_NEAR(expected.row(2, 0)[1], (128 / 255.0 - 0.45) / 0.21, 1e-5);
  const std::vector<std::pair<const void*, PixelFormat>> same = {{bgr, PixelFormat::bgr8},     {rgba, PixelFormat::rgba8},
                                                                 {bgra, PixelFormat::bgra8},   {bgr16, PixelFormat::bgr16},
                                                                 {rgb32, PixelFormat::rgb32f}, {rgba32, PixelFormat::rgba32f}};
  for (const auto& [data, format] : same) {
    const Planes in = input(model, data, format);
    for (size_t i = 0; i < 6; ++i) EXPECT_NEAR(in.data[i], expected.data[i], 1e-5) << static_cast<int>(format) << " " << i;
  }
  const Planes of_grey = input(model, grey, PixelFormat::r8);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(of_grey.row(c, 0)[0], (77 / 255.0 - model.mean[static_cast<size_t>(c)]) / model.std[static_cast<size_t>(c)],
                1e-5);
  const Planes luma = input(random_model({{4}}, 1), rgb, PixelFormat::rgb8);
  ASSERT_EQ(luma.channels, 1);
  EXPECT_NEAR(luma.data[0], ((0.299 * 10 + 0.587 * 200 + 0.114 * 30) / 255 - 0.49) / 0.2, 1e-5);
}

TEST(Network, AnImageThatIsNormalisedByItselfHasTheSameInputInAnyLight) {
  Model model = random_model({{4}});
  model.normalisation = Normalisation::image;
  model.mean = {};
  model.std = {1, 1, 1};
  const std::vector<float> pixels = {0.25f, 0.5f, 0.75f, 0.125f, 0.25f, 0.875f};
  std::vector<float> dark = pixels;
  for (float& x : dark) x = 0.1f * x + 0.03f;
  const Planes a = internal::network_input(model, {pixels.data(), 2, 1, 0, PixelFormat::rgb32f});
  const Planes b = internal::network_input(model, {dark.data(), 2, 1, 0, PixelFormat::rgb32f});
  double mean = 0, squares = 0;
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_NEAR(b.data[i], a.data[i], 1e-5);
    mean += a.data[i] / 6, squares += a.data[i] * a.data[i] / 6;
  }
  EXPECT_NEAR(mean, 0, 1e-6);
  EXPECT_NEAR(squares, 1, 1e-6);
  std::vector<float> holes = pixels;  // what is no number says nothing of the light
  holes.insert(holes.end(), {0.5f, NAN, 0.5f, 3e38f, 0.5f, 0.5f});
  const Planes d = internal::network_input(model, {holes.data(), 4, 1, 0, PixelFormat::rgb32f});
  for (int channel = 0; channel < 3; ++channel)
    for (int u = 0; u < 2; ++u) EXPECT_NEAR(d.row(channel, 0)[u], a.row(channel, 0)[u], 1e-5);
  const float flat[] = {0.5f, 0.5f, 0.501f};  // less than a step of eight bits: hardly enlarged
  const Planes c = internal::network_input(model, {flat, 1, 1, 0, PixelFormat::rgb32f});
  EXPECT_NEAR(c.data[2] - c.data[0], 0.255, 1e-4);
}

TEST(Network, WeightsAreEnlargedByPixelAreas) {
  Map in(2, 1);
  in.data = {1, 3};
  EXPECT_EQ(internal::resized(in, 4, 2).data, (std::vector<float>{1, 1.5f, 2.5f, 3, 1, 1.5f, 2.5f, 3}));
  // Sizes that were floored: 5 pixels from 2, u_in = (u + 0.5) 2/5 - 0.5.
  const Map odd = internal::resized(in, 5, 1);
  const float expected[] = {1, 1.2f, 2, 2.8f, 3};
  for (int u = 0; u < 5; ++u) EXPECT_NEAR(odd.data[static_cast<size_t>(u)], expected[u], 1e-6);
}

void expect_refused(const Model& model, const AlignerOptions& options, const std::string& piece) {
  try {
    make_cpu_aligner({.width = 96, .height = 96}, options, std::make_shared<Model>(model));
    ADD_FAILURE() << "no error, expected " << piece;
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::invalid_argument);
    EXPECT_NE(std::string(e.what()).find(piece), std::string::npos) << e.what();
  }
}

TEST(Network, WhatCannotBeIsRefused) {
  const Model good = random_model({{4, 6}, {8}});
  const auto with = [&](auto change) {
    Model model = good;
    change(model);
    return model;
  };
  AlignerOptions options = good.options();
  EXPECT_NO_THROW(make_cpu_aligner({.width = 96, .height = 96}, options, std::make_shared<Model>(good)));
  options.levels = 3;
  expect_refused(good, options, "levels is 3");
  options = good.options();
  options.robust = Robust::huber;
  expect_refused(good, options, "M-estimator");
  options = good.options();
  expect_refused(with([](Model& m) { m.encoder[0][1].in = 5; }), options, "level 0 layer 1 takes 5");
  expect_refused(with([](Model& m) { m.encoder[1][0].weight.pop_back(); }), options, "level 1 layer 0 has 431 weights");
  expect_refused(with([](Model& m) { m.encoder[1][0].bias[3] = NAN; }), options, "NaN");
  expect_refused(with([](Model& m) { m.encoder[0][0].dilation = 0; }), options, "dilation");
  expect_refused(with([](Model& m) { m.encoder[0].clear(); }), options, "number of layers of encoder level 0 is 0");
  expect_refused(with([](Model& m) { m.m_estimator.pop_back(); }), options, "gives 16 channels, must give 1");
  expect_refused(with([](Model& m) { m.input_channels = 2; }), options, "input_channels is 2");
  expect_refused(with([](Model& m) { m.std[1] = 0; }), options, "std of channel 1");
  expect_refused(with([](Model& m) { m.encoder.clear(); }), options, "levels");
}

}  // namespace
}  // namespace iclk
