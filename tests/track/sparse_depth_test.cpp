// Flights with sparse depth: features of the caller, and depth images with few pixels.
#include <functional>
#include <limits>

#include <iclk/track/internal/detector.h>
#include <iclk/track/internal/tracker_impl.h>

#include "flight.h"

namespace iclk::test {
namespace {

/// Corners of frame i and their depths.
Features corners_of(int i, int count = 80) {
  const TrackFrame frame = Flight::get().frame(i);
  return internal::detect_corners(grey_map(frame.image), frame.depth, {}, count, 16);
}

TrackFrame with(const Features& features, int i) {
  TrackFrame frame = Flight::get().frame(i);
  frame.depth = {};
  frame.features = &features;
  return frame;
}

TEST(SparseDepth, AFlightIsFollowedByFeaturesAlone) {
  ICLK_NEED_DEVICE();
  Tracking t;
  for (int i = 0; i < kFrames; ++i) {
    const Features features = corners_of(i);
    const TrackResult r = t.track(with(features, i));
    ASSERT_NE(r.status, TrackStatus::lost) << i << ": " << r.reason;
    EXPECT_LT(t.error(r, i), 0.3) << i;
    if (i > 0) continue;
    const std::vector<MapPoint> map = t.tracker.map();
    ASSERT_EQ(map.size(), features.uv.size());
    for (size_t k = 0; k < map.size(); ++k) EXPECT_EQ(map[k].uv, features.uv[k]);
  }
  EXPECT_GT(t.tracker.keyframe_count(), 2);
}

TEST(SparseDepth, FeaturesThatCannotBeUsedAreLeftOut) {
  ICLK_NEED_DEVICE();
  TrackerOptions options = options_for();
  options.masks = true;
  options.seeds = 0;
  Tracking t(options);
  std::vector<uint8_t> mask(320 * 240, 255);
  std::fill(mask.begin(), mask.begin() + 320 * 60, uint8_t{0});
  Features features = corners_of(0);
  const int good = static_cast<int>(std::count_if(features.uv.begin(), features.uv.end(), [](auto& p) { return p.y() >= 63; }));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double bad[][3] = {{-5, 100, 1},  {1, 100, 1},     {318, 100, 1}, {100, 1e300, 1},
                           {nan, 100, 1}, {100, 100, nan}, {100, 100, 0}, {100, 100, -1}};
  for (const auto& [u, v, q] : bad) {
    features.uv.emplace_back(u, v);
    features.inverse_depth.push_back(q);
  }
  TrackFrame frame = with(features, 0);
  frame.mask = {mask.data(), 320, 240, 0, PixelFormat::r8};
  ASSERT_EQ(t.track(frame).status, TrackStatus::keyframe);
  EXPECT_EQ(t.tracker.map().size(), static_cast<size_t>(good));
  for (const MapPoint& p : t.tracker.map()) EXPECT_GE(p.uv.y(), 63);
}

TEST(SparseDepth, OfManyFeaturesTheBestAreUsed) {
  ICLK_NEED_DEVICE();
  Tracking t;
  Features features;
  const View& view = Flight::get().views[0];
  for (int v = 10; v < 230; v += 3)
    for (int u = 10; u < 310; u += 3) {
      features.uv.emplace_back(u, v);
      features.inverse_depth.push_back(1 / view.depth[static_cast<size_t>(320 * v + u)]);
      features.inverse_depth_sigma.push_back(u < 160 ? 1e-5 : 0);
    }
  ASSERT_EQ(t.track(with(features, 0)).status, TrackStatus::keyframe);
  const Features& used = t.tracker.internals().keyframes.all().at(0).features;
  EXPECT_EQ(used.size(), 100);
  int quarters[4] = {};
  for (size_t i = 0; i < used.uv.size(); ++i) {
    const Eigen::Vector2d& uv = used.uv[i];
    ++quarters[(uv.x() >= 160) + 2 * (uv.y() >= 120)];
    EXPECT_DOUBLE_EQ(used.inverse_depth_sigma[i], uv.x() < 160 ? 1e-5 : 0.001 * used.inverse_depth[i]) << i;
    for (size_t j = 0; j < i; ++j) EXPECT_GE((uv - used.uv[j]).lpNorm<Eigen::Infinity>(), 8);
  }
  for (const int n : quarters) EXPECT_GE(n, 15);
}

TEST(SparseDepth, FeaturesThatDoNotFitAreRefused) {
  ICLK_NEED_DEVICE();
  Tracking t;
  const Features good = corners_of(0);
  const std::function<void(Features&)> breaks[] = {[](Features& f) { f.inverse_depth.pop_back(); },
                                                   [](Features& f) { f.uv.clear(); },
                                                   [](Features& f) { f.inverse_depth_sigma = {1e-4}; },
                                                   [](Features& f) { f.inverse_depth_sigma.assign(f.uv.size(), -1e-4); }};
  for (const auto& make_bad : breaks) {
    Features bad = good;
    make_bad(bad);
    EXPECT_THROW(t.track(with(bad, 0)), Error);
  }
  EXPECT_EQ(t.track(with({}, 0)).status, TrackStatus::lost);  // none is no error
  EXPECT_EQ(t.track(with(good, 1)).status, TrackStatus::keyframe);
}

TEST(SparseDepth, AStateHasTheFeaturesOfTheLastFrame) {
  ICLK_NEED_DEVICE();
  Tracking t, continued;
  std::vector<Features> all;
  for (int i = 0; i < 12; ++i) all.push_back(corners_of(i));
  for (int i = 0; i < 6; ++i) t.track(with(all[static_cast<size_t>(i)], i));
  continued.tracker.restore(t.tracker.state());
  EXPECT_EQ(continued.tracker.state(), t.tracker.state());
  // The jump makes a keyframe of frame 5.
  for (int i : {10, 11}) {
    const TrackResult a = t.track(with(all[static_cast<size_t>(i)], i)),
                      b = continued.track(with(all[static_cast<size_t>(i)], i));
    EXPECT_EQ(a.T_WC.matrix(), b.T_WC.matrix()) << i;
  }
  EXPECT_EQ(continued.tracker.state(), t.tracker.state());
}

/// Follows the flight with the depth of some pixels, with errors of less than `most`. Returns the number of lost frames.
int lost_with(const std::function<bool(int u, int v)>& keep, double most) {
  Tracking t;
  int lost = 0;
  for (int i = 0; i < kFrames; ++i) {
    std::vector<float> depth = Flight::get().views[static_cast<size_t>(i)].depth;
    for (int v = 0; v < 240; ++v)
      for (int u = 0; u < 320; ++u)
        if (!keep(u, v)) depth[static_cast<size_t>(320 * v + u)] = 0;
    TrackFrame frame = Flight::get().frame(i);
    frame.depth.data = depth.data();
    const TrackResult r = t.track(frame);
    if (r.status == TrackStatus::lost)
      ++lost;
    else
      EXPECT_LT(t.error(r, i), most) << i;
  }
  return lost;
}

TEST(SparseDepth, DepthOnFewLinesIsEnough) {
  ICLK_NEED_DEVICE();
  EXPECT_EQ(lost_with([](int, int v) { return v % 16 == 8; }, 0.5), 0);
}

TEST(SparseDepth, DepthAtFewPixelsIsEnough) {
  ICLK_NEED_DEVICE();
  EXPECT_EQ(lost_with([](int u, int v) { return v % 16 == 8 && u % 8 == 4; }, 0.5), 0);
}

TEST(SparseDepth, DepthOnARingIsEnough) {
  ICLK_NEED_DEVICE();
  EXPECT_EQ(lost_with([](int u, int v) { return std::abs(std::hypot(u - 160, v - 120) - 80) < 2; }, 1), 0);  // two pixels
}

}  // namespace
}  // namespace iclk::test
