// Masks of trackers, and what their keyframes and states say.
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
