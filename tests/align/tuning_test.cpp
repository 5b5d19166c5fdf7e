// Measured choices of convolution variants, and the text in which they are remembered.
#include <gtest/gtest.h>

#include <iclk/align/network/convolution.h>
#include <iclk/align/network/layer_times.h>

#include "device.h"
#include "plain_network.h"

namespace iclk {
namespace {

Tuning example() {
  Tuning tuning;
  tuning.variants[{16, 32, 2, 752, 480}] = ConvVariant::winograd4x1;
  tuning.variants[{3, 16, 1, 752, 480}] = ConvVariant::direct;
  tuning.variants[{16, 32, 2, 752, 480, true}] = ConvVariant::winograd4x1;
  tuning.variants[{128, 128, 2, 94, 60}] = ConvVariant::winograd4;
  return tuning;
}

TEST(Tuning, TextIsReadBack) {
  const std::string text = example().text("device-1-abc");
  const auto read = Tuning::parse(text, "device-1-abc");
  ASSERT_TRUE(read);
  EXPECT_EQ(read->variants, example().variants);
  EXPECT_TRUE(Tuning::parse(Tuning{}.text("k"), "k"));
}

TEST(Tuning, WhatIsDamagedOrForeignIsNothing) {
  const std::string key = "device-1-abc", text = example().text(key);
  EXPECT_FALSE(Tuning::parse(text, "device-2-abc"));
  EXPECT_FALSE(Tuning::parse("", key));
  for (size_t length = 0; length < text.size(); ++length) EXPECT_FALSE(Tuning::parse(text.substr(0, length), key)) << length;
  for (size_t at = 0; at < text.size(); ++at)
    for (char c : {'\0', ' ', '\n', 'x', '-', '\xff'}) {
      std::string damaged = text;
      if (damaged[at] == c) continue;
      damaged[at] = c;
      EXPECT_FALSE(Tuning::parse(damaged, key)) << at;
    }
  EXPECT_FALSE(Tuning::parse(text + "3 16 1 752 480 direct\n", key));
  EXPECT_FALSE(Tuning::parse(text + std::string(100, '9'), key));
  // Of the form that had a precision.
  EXPECT_FALSE(Tuning::parse("iclk-tuning 4\ndevice-1-abc\n1\n3 16 1 752 480 fp16 0 direct\na13a138bb1b0e9c1\n", key));
}

TEST(Tuning, ChoosesWhatWasMeasuredElseTheUsual) {
  const Tuning tuning = example();
  for (const auto type : {engine::DeviceType::cpu, engine::DeviceType::discrete}) {
    EXPECT_EQ(tuning.choose({16, 32, 2, 752, 480}, type), ConvVariant::winograd4x1);
    EXPECT_EQ(tuning.choose({3, 16, 1, 752, 480}, type), ConvVariant::direct);
    EXPECT_EQ(tuning.choose({16, 32, 2, 752, 480, true}, type), ConvVariant::winograd4x1);
    for (const ConvShape& other : {ConvShape{16, 32, 2, 376, 240}, ConvShape{1, 32, 1, 376, 240}})
      EXPECT_EQ(tuning.choose(other, type), usual_variant(other, type));
  }
}

TEST(Tuning, TheUsualChoiceOfACpuIsWhatLavapipeIsFastestWith) {
  const auto usual = [](int in, int out, int dilation, int width, int height) {
    const ConvShape shape{in, out, dilation, width, height};
    auto last = shape;
    last.last = true;
    const ConvVariant found = usual_variant(shape, engine::DeviceType::cpu);
    EXPECT_EQ(usual_variant(last, engine::DeviceType::cpu), found);
    return found;
  };
  // By 1.1 times and more where they were measured.
  EXPECT_EQ(usual(3, 8, 1, 640, 480), ConvVariant::winograd4x1);
  EXPECT_EQ(usual(8, 16, 2, 320, 240), ConvVariant::winograd4x1);
  EXPECT_EQ(usual(16, 16, 1, 160, 120), ConvVariant::winograd4x1);
  EXPECT_EQ(usual(64, 64, 2, 20, 15), ConvVariant::winograd4x1);
  EXPECT_EQ(usual(32, 32, 1, 40, 30), ConvVariant::winograd4x1);
  EXPECT_EQ(usual(16, 32, 2, 320, 240), ConvVariant::winograd4);
  EXPECT_EQ(usual(32, 48, 2, 188, 120), ConvVariant::winograd4);
  EXPECT_EQ(usual(64, 64, 1, 40, 30), ConvVariant::winograd4);
  EXPECT_EQ(usual(96, 128, 1, 94, 60), ConvVariant::winograd4);
  // What no 32 bits hold.
  EXPECT_EQ(usual(1024, 1024, 1, 8192, 8192), ConvVariant::winograd4);
}

TEST(Tuning, TheUsualChoiceOfWhatIsNoCpuFitsEveryGpu) {
  using enum engine::DeviceType;
  for (const auto type : {discrete, integrated, virtual_gpu, other})
    for (const ConvShape& shape : {ConvShape{3, 8, 1, 640, 480}, ConvShape{64, 64, 2, 80, 60}, ConvShape{128, 128, 1, 20, 15}})
      EXPECT_EQ(Tuning().choose(shape, type), ConvVariant::direct);
}

TEST(Tuning, MeasuresWhatIsMissing) {
  ICLK_NEED_DEVICE();
  const auto model = test::odd_model();
  const auto shapes = encoder_shapes(*model, 64, 48, 2);
  ASSERT_EQ(shapes.size(), 5u);
  EXPECT_EQ(encoder_shapes(*model, 64, 48, 99).size(), 10u);
  Tuning known;
  known.variants[shapes[0]] = ConvVariant::winograd4;
  std::vector<int> calls;
  const auto progress = [&](int layer, int layers) {
    EXPECT_EQ(layers, 4);
    calls.push_back(layer);
  };
  const Tuning tuned = tune(test::device(), shapes, known, progress);
  EXPECT_EQ(calls, (std::vector<int>{0, 1, 2, 3}));
  EXPECT_EQ(tuned.variants.size(), 5u);
  EXPECT_EQ(tuned.variants.at(shapes[0]), ConvVariant::winograd4);
  const auto none = [](int, int) { ADD_FAILURE() << "measured again"; };
  EXPECT_EQ(tune(test::device(), shapes, tuned, none).variants, tuned.variants);
}

TEST(Tuning, DropsWhatReadsTexelBuffersWhereTheseAreTooSmall) {
  ICLK_NEED_DEVICE();
  auto request = test::watched_options();
  request.storage_reads = true;
  request.subgroups = false;  // each of its kernels by itself
  const LayerTimes times = time_layers(engine::create_context(request), {{8, 16, 2, 24, 20}}, 1).front();
  EXPECT_EQ(times.ways.size(), 2u);
  ASSERT_EQ(times.dropped.size(), 1u);
  EXPECT_EQ(times.dropped[0].variant, ConvVariant::winograd4);
  EXPECT_NE(times.dropped[0].why.find("texel buffers"), std::string::npos) << times.dropped[0].why;
}

TEST(Tuning, KeyNamesDeviceDriverAndShaders) {
  ICLK_NEED_DEVICE();
  const std::string key = tuning_key(*test::device());
  EXPECT_EQ(key.rfind(engine::uuid_text(test::device()->info().uuid), 0), 0u);
  EXPECT_EQ(key.find_first_not_of("0123456789abcdefghijklmnopqrstuvwxyz-"), std::string::npos) << key;
  auto request = test::watched_options();
  request.subgroups = false;
  const bool others = internal::can_shuffle(test::device()->info());  // shaders
  EXPECT_EQ(tuning_key(*engine::create_context(request)) != key, others);
}

}  // namespace
}  // namespace iclk
