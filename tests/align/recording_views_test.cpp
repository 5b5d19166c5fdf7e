// record() on images that are sampled through views: any mip, layer and format.
#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include <iclk/align/device_recording.h>
#include <iclk/engine/error.h>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

Relief scene_of() {
  Relief scene;
  scene.T_10.t = {0.05, -0.025, 0.05};
  scene.T_10.R = SE3::exp((Vector6d() << 0, 0, 0, 0.01, -0.01, 0.02).finished()).R;
  return scene;
}

/// A view of pixels of type T that the plan has as floats or bytes.
struct Case {
  const char* name;
  VkFormat format;
  PixelFormat plan;
  int channels;
  bool grey;
  uint32_t mip, layer;
};

void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class RecordingViews : public ::testing::TestWithParam<Case> {};

// Grey values that eight bits and half floats hold alike.
float value(float I) { return std::round(255 * std::clamp(I, 0.0f, 1.0f)) / 256; }

template <class T>
std::vector<T> pixels_of(const Frame& frame, int channels, T (*convert)(float)) {
  std::vector<T> out;
  for (const float I : frame.data)
    for (int c = 0; c < channels; ++c) out.push_back(convert(c == 3 ? 255.0f / 256 : value(I)));
  return out;
}

uint8_t as_byte(float x) { return static_cast<uint8_t>(std::lround(256 * x)); }
uint16_t as_half(float x) { return Eigen::half(x).x; }
float as_float(float x) { return x; }

TEST_P(RecordingViews, GiveWhatTheHostsPixelsGive) {
  ICLK_NEED_DEVICE();
  const Case c = GetParam();
  Application app;
  const auto context = app.adopt();
  const Relief scene = scene_of();
  const Features features = random_features(scene, 50, 1);
  Plan plan = plan_for(scene.camera);
  plan.format = c.plan;
  DeviceAligner aligner(context, plan, {}, Solver::device);

  // What the host gives has the plan's format; the images of the application have theirs.
  const bool bytes = c.plan == PixelFormat::r8 || c.plan == PixelFormat::rgba8;
  std::vector<std::unique_ptr<ApplicationImage>> kept;
  std::vector<std::vector<uint8_t>> host_bytes;
  std::vector<std::vector<float>> host_floats;
  for (const int which : {0, 1}) {
    const Frame frame = render(scene, which);
    host_bytes.push_back(pixels_of(frame, channels(c.plan), as_byte));
    host_floats.push_back(pixels_of(frame, channels(c.plan), as_float));
    kept.push_back(std::make_unique<ApplicationImage>(app, 160u << c.mip, 120u << c.mip, c.format,
                                                      VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, c.mip + 1, c.layer + 1));
    if (bytes) {
      const auto pixels = pixels_of(frame, c.channels, as_byte);
      kept.back()->fill(context, pixels.data(), pixels.size(), c.mip, c.layer);
    } else {
      const auto pixels = pixels_of(frame, c.channels, as_half);
      kept.back()->fill(context, pixels.data(), 2 * pixels.size(), c.mip, c.layer);
    }
  }
  const auto host = [&](size_t which) {
    const void* data = bytes ? static_cast<const void*>(host_bytes[which].data()) : host_floats[which].data();
    return ImageView{data, 160, 120, 0, c.plan};
  };
  DeviceAligner other(context, plan, {}, Solver::device);
  other.set_reference(0, {host(0), scene.camera, features, {}});
  const Alignment expected = other.align({.target = host(1)});
  ASSERT_TRUE(expected.converged()) << expected.reason;

  const auto view = [&](size_t which) {
    return DeviceImageView{kept[which]->view(c.mip, c.layer), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, 160, 120, c.grey};
  };
  const auto recording = aligner.make_recording();
  const ApplicationCommands commands(app);
  const DeviceReference reference{0, view(0), scene.camera, features};
  const DevicePair pair{0, view(1), {}, {}};
  aligner.record(*recording, commands.commands, {&reference, 1}, {&pair, 1});
  commands.end();
  commands.submit_and_wait();
  EXPECT_TRUE(same_bits(recording->read().at(0), expected)) << recording->read()[0].reason;
}

INSTANTIATE_TEST_SUITE_P(All, RecordingViews,
                         testing::Values(Case{"rgba8", VK_FORMAT_R8G8B8A8_UNORM, PixelFormat::rgba8, 4, false, 0, 0},
                                         Case{"mip_and_layer", VK_FORMAT_R8G8B8A8_UNORM, PixelFormat::rgba8, 4, false, 2, 1},
                                         Case{"r8", VK_FORMAT_R8_UNORM, PixelFormat::r8, 1, true, 0, 0},
                                         Case{"rg8_as_grey", VK_FORMAT_R8G8_UNORM, PixelFormat::r8, 2, true, 1, 0},
                                         Case{"half_colours", VK_FORMAT_R16G16B16A16_SFLOAT, PixelFormat::rgba32f, 4, false, 0,
                                              1},
                                         Case{"half_grey", VK_FORMAT_R16_SFLOAT, PixelFormat::r32f, 1, true, 1, 1}),
                         [](const auto& test) { return test.param.name; });

TEST(RecordingViews, WhatCannotBeRecordedIsRefusedByName) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief scene;
  Plan plan = plan_for(scene.camera);
  plan.format = PixelFormat::rgba8;
  DeviceAligner aligner(context, plan, {}, Solver::device);
  ApplicationImage image(app, 160, 120, VK_FORMAT_R8G8B8A8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
  const auto recording = aligner.make_recording();
  const ApplicationCommands host(app);
  const DeviceReference reference{0, image.foreign, scene.camera, random_features(scene, 20)};
  const DeviceImageView good{image.view(), VK_IMAGE_LAYOUT_GENERAL, 160, 120, false};
  const auto refused = [&](auto change, const std::string& part) {
    DeviceImageView view = good;
    change(view);
    const DevicePair pair{0, view, {}, {}};
    try {
      aligner.record(*recording, host.commands, {&reference, 1}, {&pair, 1});
      ADD_FAILURE() << part << " was accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
  };
  refused([](DeviceImageView& v) { v.view = VK_NULL_HANDLE; }, "pair 0, target: the VkImageView is null");
  refused([](DeviceImageView& v) { v.width = 80; }, "80x120, but the plan was made for 160x120");
  refused([](DeviceImageView& v) { v.layout = VK_IMAGE_LAYOUT_UNDEFINED; }, "VK_IMAGE_LAYOUT_UNDEFINED");
  host.end();
}

}  // namespace
}  // namespace iclk::test
