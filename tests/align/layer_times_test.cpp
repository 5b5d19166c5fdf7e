// Which variant of a convolution a layer gets, and what a device cannot measure.
#include <gtest/gtest.h>

#include <iclk/align/network/layer_times.h>

#include "device.h"

namespace iclk::internal {
namespace {

TEST(ChosenVariant, OfACpuIsWhatLavapipeIsFastestWith) {
  const auto chosen = [](int in, int out, int dilation, int width, int height) {
    return choose_variant({in, out, dilation, width, height}, engine::DeviceType::cpu);
  };
  // By 1.1 times and more where they were measured.
  EXPECT_EQ(chosen(3, 8, 1, 640, 480), ConvVariant::winograd4x1);
  EXPECT_EQ(chosen(8, 16, 2, 320, 240), ConvVariant::winograd4x1);
  EXPECT_EQ(chosen(16, 16, 1, 160, 120), ConvVariant::winograd4x1);
  EXPECT_EQ(chosen(64, 64, 2, 20, 15), ConvVariant::winograd4x1);
  EXPECT_EQ(chosen(32, 32, 1, 40, 30), ConvVariant::winograd4x1);
  EXPECT_EQ(chosen(16, 32, 2, 320, 240), ConvVariant::winograd4);
  EXPECT_EQ(chosen(32, 48, 2, 188, 120), ConvVariant::winograd4);
  EXPECT_EQ(chosen(64, 64, 1, 40, 30), ConvVariant::winograd4);
  EXPECT_EQ(chosen(96, 128, 1, 94, 60), ConvVariant::winograd4);
  // What no 32 bits hold.
  EXPECT_EQ(chosen(1024, 1024, 1, 8192, 8192), ConvVariant::winograd4);
}

TEST(ChosenVariant, OfWhatIsNoCpuFitsEveryGpu) {
  using enum engine::DeviceType;
  for (const auto type : {discrete, integrated, virtual_gpu, other})
    for (const ConvShape& shape : {ConvShape{3, 8, 1, 640, 480}, ConvShape{64, 64, 2, 80, 60}, ConvShape{128, 128, 1, 20, 15}})
      EXPECT_EQ(choose_variant(shape, type), ConvVariant::direct);
}

TEST(LayerTimes, AreOfWhatTheDeviceHasAKernelFor) {
  ICLK_NEED_DEVICE();
  const LayerTimes times = time_layers(test::device_without_subgroups(), {{8, 16, 2, 24, 20}}, 1, [](int, int) {}).front();
  ASSERT_EQ(times.ways.size(), 1u);
  EXPECT_EQ(times.ways[0].variant, ConvVariant::direct);
  EXPECT_EQ(times.way(ConvVariant::winograd4), nullptr);
}

}  // namespace
}  // namespace iclk::internal
