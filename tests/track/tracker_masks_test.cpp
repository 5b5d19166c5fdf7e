// Masks of trackers, and what their keyframes and states say.
#include <type_traits>
#include <utility>

#include <iclk/track/internal/hidden.h>

#include "flight.h"

namespace iclk::test {
namespace {

TrackerOptions with_masks() {
  TrackerOptions options = options_for();
  options.masks = true;
  return options;
}

/// Hides the lower third of an image.
std::vector<uint8_t> vehicle_mask() {
  std::vector<uint8_t> mask(320 * 240, 255);
  std::fill(mask.begin() + 320 * 160, mask.end(), uint8_t{0});
  return mask;
}

TEST(Tracker, AMaskHidesWhatRidesAlong) {
  ICLK_NEED_DEVICE();
  Tracking t(with_masks());
  // The lower third of every image shows the own vehicle: the first frame's pixels, standing still, with no depth.
  std::vector<uint8_t> mask = vehicle_mask();
  for (int i = 0; i < 6; ++i) {
    View view = Flight::get().views[static_cast<size_t>(i)];
    const View& first = Flight::get().views[0];
    std::copy(first.rgba.begin() + 320 * 160, first.rgba.end(), view.rgba.begin() + 320 * 160);
    std::fill(view.depth.begin() + 320 * 160, view.depth.end(), 0.0f);
    TrackFrame frame{0.1 * i, view.image(), view.depth_image(), {mask.data(), 320, 240, 0, PixelFormat::r8}};
    const TrackResult r = t.track(frame);
    ASSERT_NE(r.status, TrackStatus::lost) << r.reason;
    EXPECT_LT(t.error(r, i), 0.3) << i;
  }
}

TEST(Tracker, WhatAMaskHidesDoesNotMatter) {
  ICLK_NEED_DEVICE();
  std::vector<uint8_t> mask = vehicle_mask();
  // The vehicle: black, or with more texture than the ground. It stands still.
  const auto follow = [&](uint32_t texture) {
    Tracking t(with_masks());
    uint32_t state = 1;
    std::vector<uint32_t> vehicle(320 * 80);
    for (uint32_t& p : vehicle) p = 0xff000000u | (((state = state * 1664525u + 1013904223u) >> 8) & texture);
    for (int i = 0; i < kFrames; ++i) {
      View view = Flight::get().views[static_cast<size_t>(i)];
      std::copy(vehicle.begin(), vehicle.end(), view.rgba.begin() + 320 * 160);
      const TrackResult r = t.track({0.1 * i, view.image(), view.depth_image(), {mask.data(), 320, 240, 0, PixelFormat::r8}});
      EXPECT_NE(r.status, TrackStatus::lost) << i << ": " << r.reason;
      EXPECT_LT(t.error(r, i), 0.3) << i;
    }
    return std::move(t.results);
  };
  const std::vector<TrackResult> plain = follow(0), textured = follow(0xffffff);
  for (size_t i = 0; i < plain.size(); ++i) {
    EXPECT_EQ(plain[i].status, textured[i].status) << i;
    EXPECT_LT((plain[i].T_WC.t - textured[i].T_WC.t).norm(), 0.05) << i;
  }
}

TEST(Tracker, HiddenPixelsContinueTheSeenOnes) {
  const Camera camera{60, 60, 31.5, 23.5, 64, 48};
  for (const PixelFormat format : {PixelFormat::r8, PixelFormat::rgb16, PixelFormat::r32f}) {
    const auto n = static_cast<size_t>(channels(format));
    internal::FramePixels pixels;
    pixels.format = format;
    pixels.image.assign(64 * 48 * bytes_per_pixel(format), 0);
    pixels.mask.assign(64 * 48, 255);
    const auto each = [&](const auto& visit) {
      for (size_t i = 0; i < 64 * 48 * n; ++i) {
        if (format == PixelFormat::r8) visit(i, pixels.image[i]);
        if (format == PixelFormat::rgb16) visit(i, reinterpret_cast<uint16_t*>(pixels.image.data())[i]);
        if (format == PixelFormat::r32f) visit(i, reinterpret_cast<float*>(pixels.image.data())[i]);
      }
    };
    // A ramp along the rows, other in each channel, hidden by something dark on the right and below.
    const auto ramp = [&](size_t i) { return 20 + 2 * static_cast<double>(i / n / 64) + 10 * static_cast<double>(i % n); };
    each([&](size_t i, auto& value) {
      const size_t u = i / n % 64, v = i / n / 64;
      const bool hidden = u >= 40 || v >= 40;
      if (hidden) pixels.mask[i / n] = 0;
      value = static_cast<std::remove_reference_t<decltype(value)>>(hidden ? 0 : ramp(i));
    });
    internal::fill_hidden(pixels, camera);
    each([&](size_t i, auto value) {
      const size_t u = i / n % 64, v = i / n / 64;
      const bool near = u < 44 && v < 36;
      EXPECT_NEAR(static_cast<double>(value), ramp(i), u < 40 && v < 40 ? 0 : near ? 30 : 60) << u << " " << v;
    });
  }
}

TEST(Tracker, NoFeatureOfAKeyframeIsUnderItsMask) {
  ICLK_NEED_DEVICE();
  Tracking t(with_masks());
  // The lower third shows the own vehicle, to which the sensor gives a depth as well.
  std::vector<uint8_t> mask = vehicle_mask();
  for (int i = 0; i < 10; ++i) {
    TrackFrame frame = Flight::get().frame(i);
    frame.mask = {mask.data(), 320, 240, 0, PixelFormat::r8};
    ASSERT_NE(t.track(frame).status, TrackStatus::lost) << i;
  }
  EXPECT_GT(t.tracker.keyframe_count(), 1);
  for (const MapPoint& p : t.tracker.map()) EXPECT_LT(p.uv.y(), 160) << p.keyframe;
}

TEST(Tracker, AKeyframeNamesTheOneItWasFoundBy) {
  ICLK_NEED_DEVICE();
  Tracking t;
  int others = 0;
  for (int i = 0; i < 12; ++i) {
    const TrackResult r = t.track(i);
    EXPECT_EQ(r.origin.has_value(), i > 0 && r.status == TrackStatus::keyframe) << i;
    if (r.status != TrackStatus::keyframe) continue;
    EXPECT_TRUE(r.covariance.isZero()) << i;  // of the identity
    if (!r.origin) continue;
    ++others;
    EXPECT_LT(r.origin->keyframe, r.keyframe);
    EXPECT_GT(r.origin->covariance.trace(), 0);
    EXPECT_LT((t.tracker.keyframe_pose(r.origin->keyframe) * r.origin->T_CK.inverse() * r.T_WC.inverse()).t.norm(), 0.3);
  }
  EXPECT_GT(others, 0);
}

TEST(Tracker, EveryKeyframeIsReported) {
  ICLK_NEED_DEVICE();
  TrackerOptions options = options_for();
  options.masks = true;
  Tracking t(options);
  // The keyframe has features on the left alone, the third frame shows the right: only the second one has both.
  std::vector<uint8_t> left(320 * 240, 0), right(320 * 240, 0);
  for (size_t i = 0; i < left.size(); ++i) (i % 320 < 160 ? left : right)[i] = 255;
  const auto track = [&](int i, const std::vector<uint8_t>& mask) {
    TrackFrame frame = Flight::get().frame(i);
    if (!mask.empty()) frame.mask = {mask.data(), 320, 240, 0, PixelFormat::r8};
    return t.track(frame);
  };
  EXPECT_EQ(track(0, left).keyframe, 0);
  EXPECT_EQ(track(1, {}).status, TrackStatus::tracked);
  const TrackResult r = track(2, right);
  ASSERT_NE(r.status, TrackStatus::lost) << r.reason;
  ASSERT_TRUE(r.before);
  EXPECT_EQ(r.before->keyframe, 1);
  EXPECT_EQ(r.before->time, 0.1);
  EXPECT_EQ(t.tracker.keyframe_count(), r.status == TrackStatus::keyframe ? 3 : 2);
}

TEST(Tracker, AStateThatDoesNotFitLeavesTheTrackerAsItWas) {
  ICLK_NEED_DEVICE();
  TrackerOptions few = options_for();
  few.features = 60;
  Tracking many, t(few), undisturbed(few);
  for (int i = 0; i < 4; ++i) many.track(i);
  for (int i = 4; i < 8; ++i) {
    t.track(i);
    undisturbed.track(i);
  }
  EXPECT_THROW(t.tracker.restore(many.tracker.state()), Error);  // of more features than its aligner holds
  for (int i = 8; i < 10; ++i) EXPECT_EQ(t.track(i).T_WC.matrix(), undisturbed.track(i).T_WC.matrix()) << i;
  EXPECT_EQ(t.tracker.state(), undisturbed.tracker.state());
}

TEST(Tracker, MasksOfAnotherSizeOrFormatAreRefused) {
  ICLK_NEED_DEVICE();
  TrackerOptions options = options_for();
  options.masks = true;
  Tracking t(options);
  const std::vector<uint8_t> seen(320 * 240 * 4, 255);
  TrackFrame frame = Flight::get().frame(0);
  for (const ImageView& bad : {ImageView{seen.data(), 8, 8, 0, PixelFormat::r8},
                               {seen.data(), 640, 240, 0, PixelFormat::r8},
                               {seen.data(), 320, 240, 100, PixelFormat::r8},
                               {seen.data(), 320, 240, 0, PixelFormat::r32f}}) {
    frame.mask = bad;
    EXPECT_THROW(t.track(frame), Error) << bad.width << "x" << bad.height;
  }
  frame.mask = {seen.data(), 320, 240, 0, PixelFormat::r8};
  EXPECT_EQ(t.track(frame).status, TrackStatus::keyframe);
}

}  // namespace
}  // namespace iclk::test
