// A flight over terrain made in code, with exact depth and poses, and what goes wrong on flights.
#include <iclk/track/internal/tracker_impl.h>

#include <cstring>
#include <random>

#include "flight.h"

namespace iclk::test {
namespace {

TEST(Tracker, AFlightIsFollowed) {
  ICLK_NEED_DEVICE();
  Tracking t;
  double way = 0;
  for (int i = 0; i < kFrames; ++i) {
    const TrackResult r = t.track(i);
    ASSERT_NE(r.status, TrackStatus::lost) << i << ": " << r.reason;
    EXPECT_TRUE(r.confirmed) << i << ": " << r.reason;
    if (i > 0) way += (camera_pose(i).t - camera_pose(i - 1).t).norm();
    EXPECT_LT(t.error(r, i), 0.3) << i;  // half a pixel
    if (i > 0 && r.status == TrackStatus::tracked) {
      EXPECT_GT(r.covariance.trace(), 0);
      EXPECT_GE(r.inliers, 20);
    }
  }
  EXPECT_GT(way, 70);
  EXPECT_GT(t.tracker.keyframe_count(), 2);
  EXPECT_LT(t.tracker.keyframe_count(), kFrames / 2);
  // By the keyframes' last poses the way is at least as good as it was told on the way.
  std::vector<PosePair> pairs;
  for (int i = 0; i < kFrames; ++i) {
    const TrackResult& r = t.results[static_cast<size_t>(i)];
    pairs.push_back({t.tracker.keyframe_pose(r.keyframe) * r.T_CK.inverse(), Flight::get().truth[static_cast<size_t>(i)]});
  }
  EXPECT_LT(absolute_error(pairs).rmse, 0.001 * way);
}

TEST(Tracker, TheCpuFollowsItAsWell) {
  ICLK_NEED_DEVICE();  // for the renderer
  Tracking on_device, on_cpu(options_for(), true);
  for (int i = 0; i < 4; ++i) {
    const TrackResult a = on_device.track(i), b = on_cpu.track(i);
    EXPECT_EQ(a.status, b.status);
    EXPECT_LT((a.T_WC.t - b.T_WC.t).norm(), 0.02) << i;
  }
}

TEST(Tracker, ALensCapIsLostAndThenFoundAgain) {
  ICLK_NEED_DEVICE();
  Tracking t;
  const std::vector<uint32_t> black(320 * 240, 0xff000000u);
  for (int i = 0; i < 11; ++i) t.track(i);
  for (int i = 11; i < 21; ++i) {
    TrackFrame covered = Flight::get().frame(i);
    covered.image.data = black.data();
    const TrackResult r = t.track(covered);
    EXPECT_EQ(r.status, TrackStatus::lost);
    EXPECT_FALSE(r.confirmed);
    EXPECT_EQ(r.T_WC.t, t.results[10].T_WC.t);  // the last that was known
    EXPECT_TRUE(r.covariance.isZero());
  }
  const TrackResult back = t.track(21);
  ASSERT_NE(back.status, TrackStatus::lost) << back.reason;
  EXPECT_TRUE(back.searched);
  EXPECT_EQ(back.map, 0);
  EXPECT_LT(t.error(back, 21), 0.3);
  EXPECT_NE(t.track(22).status, TrackStatus::lost);
}

TEST(Tracker, AMapThatBeganBadlyIsLeft) {
  ICLK_NEED_DEVICE();
  Tracking t;
  // The first frame is of another place, seen once.
  View noise = Flight::get().views[0];
  uint32_t state = 1;
  for (uint32_t& p : noise.rgba) p = 0xff000000u | ((state = state * 1664525u + 1013904223u) >> 8);
  EXPECT_EQ(t.track({0, noise.image(), noise.depth_image(), {}}).status, TrackStatus::keyframe);
  EXPECT_EQ(t.track(1).status, TrackStatus::lost);
  // Black frames are no place to begin anew.
  const std::vector<uint32_t> black(320 * 240, 0xff000000u);
  TrackFrame covered = Flight::get().frame(2);
  covered.image.data = black.data();
  EXPECT_EQ(t.track(covered).map, 0);
  for (int i = 3; i < 9; ++i) {
    const TrackResult r = t.track(i);
    ASSERT_NE(r.status, TrackStatus::lost) << r.reason;
    EXPECT_EQ(r.map, 1);
    EXPECT_LT(t.error(r, i, 1), 0.3) << i;  // the lost frame became the first keyframe
    ASSERT_EQ(r.before.has_value(), i == 3);
    if (i == 3) {
      EXPECT_EQ(r.before->time, Flight::get().frame(1).time);
    }
  }
}

/// Another place begins a map of its own as soon as two frames of it agree. When the first place is seen again, both are one.
TEST(Tracker, MapsAreJoinedWhereTheyMeet) {
  ICLK_NEED_DEVICE();
  Tracking t;
  double time = 0;
  const auto track = [&](int i) {
    TrackFrame frame = Flight::get().frame(i);
    frame.time = time += 0.1;
    return t.track(frame);
  };
  for (int i = 0; i < 4; ++i) EXPECT_EQ(track(i).map, 0);
  EXPECT_EQ(track(23).status, TrackStatus::lost);
  const TrackResult anew = track(22);
  ASSERT_EQ(anew.status, TrackStatus::tracked) << anew.reason;
  EXPECT_EQ(anew.map, 1);
  std::vector<TrackResult> back;
  for (int i = 21; i > 1; --i) {
    back.push_back(track(i));
    ASSERT_NE(back.back().status, TrackStatus::lost) << i << ": " << back.back().reason;
  }
  EXPECT_EQ(back.front().map, 1);
  EXPECT_EQ(back.back().map, 0);
  EXPECT_EQ(t.tracker.keyframe_map(anew.keyframe), 0);
  int i = 21;
  for (const TrackResult& r : back) EXPECT_LT(t.error(r, i--), 0.6) << i + 1;  // by the keyframes' last poses
  EXPECT_LT(t.error(anew, 22), 0.6);
}

TEST(Tracker, AJumpIsFoundOrSaidToBeLost) {
  ICLK_NEED_DEVICE();
  Tracking t;
  for (int i = 0; i < 5; ++i) t.track(i);
  TrackFrame jump = Flight::get().frame(9);  // 13 m farther on
  jump.time = 0.5;
  const TrackResult r = t.track(jump);
  if (r.status != TrackStatus::lost) {
    EXPECT_LT(t.error(r, 9), 0.5) << r.reason;
  }
}

TEST(Tracker, AFrozenCameraStays) {
  ICLK_NEED_DEVICE();
  Tracking t;
  for (int i = 0; i < 6; ++i) {
    TrackFrame frame = Flight::get().frame(0);
    frame.time = i;
    const TrackResult r = t.track(frame);
    EXPECT_NE(r.status, TrackStatus::lost);
    EXPECT_LT(r.T_WC.t.norm(), 1e-3);
  }
  EXPECT_EQ(t.tracker.keyframe_count(), 1);
}

TEST(Tracker, ACameraThatOnlyTurnsIsFollowedOrSaidToBeLost) {
  ICLK_NEED_DEVICE();
  TerrainRenderer renderer(device(), std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256})));
  const SE3 start = camera_pose(0);
  for (const bool depth : {true, false}) {
    Tracking t;
    int lost = 0;
    for (int i = 0; i < 10; ++i) {
      SE3 T = start;
      T.R = start.R * Eigen::AngleAxisd(0.08 * i, Eigen::Vector3d(0.3, 0.2, 1).normalized()).toRotationMatrix();
      const View view = renderer.render(Flight::get().camera, T);
      const TrackResult r = t.track({0.1 * i, view.image(), depth || i == 0 ? view.depth_image() : ImageView(), {}});
      lost += r.status == TrackStatus::lost;
      if (r.status == TrackStatus::lost) continue;
      const SE3 off = (start.inverse() * T).inverse() * r.T_WC;
      EXPECT_LT(off.t.norm(), 0.5) << i;
      EXPECT_LT(off.log().tail<3>().norm(), 0.003) << i;
    }
    EXPECT_LE(lost, depth ? 0 : 4);
  }
}

TEST(Tracker, FramesWithoutDepthAreTracked) {
  ICLK_NEED_DEVICE();
  TrackerOptions options = options_for();
  options.seeds = 0;
  Tracking t(options);
  TrackFrame blind = Flight::get().frame(0);
  blind.depth = {};
  const TrackResult none = t.track(blind);
  EXPECT_EQ(none.status, TrackStatus::lost);
  EXPECT_NE(none.reason.find("depth"), std::string::npos);
  t.track(1);
  for (int i = 2; i < 6; ++i) {
    TrackFrame frame = Flight::get().frame(i);
    frame.depth = {};
    const TrackResult r = t.track(frame);
    EXPECT_EQ(r.status, TrackStatus::tracked) << r.reason;  // and never a keyframe
    EXPECT_LT(t.error(r, i, 1), 0.1);
  }
}

TEST(Tracker, DepthOfTheFirstFrameIsEnough) {
  ICLK_NEED_DEVICE();
  Tracking t;
  int by_motion = 0;
  for (int i = 0; i < kFrames; ++i) {
    TrackFrame frame = Flight::get().frame(i);
    if (i > 0) frame.depth = {};
    const TrackResult r = t.track(frame);
    ASSERT_NE(r.status, TrackStatus::lost) << i << ": " << r.reason;
    EXPECT_TRUE(r.confirmed) << i;
    EXPECT_LT(t.error(r, i), 0.6) << i;
    by_motion += i > 0 && r.status == TrackStatus::keyframe;
  }
  EXPECT_GE(by_motion, 3);
  // Seeds became features: more than were carried over from the first keyframe, in places that it did not see.
  int beyond = 0;
  std::vector<double> errors;
  const internal::Keyframe& last = t.tracker.internals().keyframes.all().rbegin()->second;
  const SE3& origin = Flight::get().truth[0];
  const auto frame = static_cast<size_t>(std::lround(last.time / 0.1));
  for (size_t i = 0; i < last.features.uv.size(); ++i) {
    const double q = last.features.inverse_depth[i];
    const Eigen::Vector2d& uv = last.features.uv[i];
    const Eigen::Vector3d X = Flight::get().truth[frame] * (Flight::get().camera.ray(uv) / q);
    beyond += !Flight::get().camera.contains(Flight::get().camera.project(origin.inverse() * X));
    const View& view = Flight::get().views[frame];
    const double z = view.depth[static_cast<size_t>(320 * std::lround(uv.y()) + std::lround(uv.x()))];
    errors.push_back(std::abs(q * z - 1));
  }
  EXPECT_GT(beyond, 20);
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.01);
  EXPECT_LT(errors[errors.size() * 9 / 10], 0.03);
}

TEST(Tracker, MemoryIsBounded) {
  ICLK_NEED_DEVICE();
  TrackerOptions options = options_for();
  options.keyframes = 3;
  options.window = 2;
  options.min_visible = 0.95;
  Tracking t(options);
  for (int i = 0; i < 14; ++i) {
    const TrackResult r = t.track(i);
    EXPECT_NE(r.status, TrackStatus::lost) << i << ": " << r.reason;
    EXPECT_LT(t.error(r, i), 0.3) << i;
  }
  EXPECT_GT(t.tracker.keyframe_count(), 4);
  const auto& held = t.tracker.internals().keyframes.all();
  EXPECT_EQ(held.size(), 3u);
  for (const auto& [id, k] : held)
    for (const auto& [seen_in, features] : k.sightings) EXPECT_TRUE(held.count(seen_in)) << id;
}

TEST(Tracker, AStateGoesOnToTheBit) {
  ICLK_NEED_DEVICE();
  Tracking whole, stopped, next;
  const auto frame = [](int i) {  // every other one without depth: seeds are part of a state
    TrackFrame out = Flight::get().frame(i);
    if (i % 4 > 0) out.depth = {};
    return out;
  };
  for (int i = 0; i < 8; ++i) {
    whole.track(frame(i));
    stopped.track(frame(i));
  }
  size_t seeds = 0;
  for (const auto& [id, k] : stopped.tracker.internals().keyframes.all()) seeds += k.seeds.size();
  EXPECT_GT(seeds, 20u);
  const std::vector<uint8_t> state = stopped.tracker.state();
  EXPECT_EQ(whole.tracker.state(), state);
  next.tracker.restore(state);
  EXPECT_EQ(next.tracker.state(), state);
  for (int i = 8; i < 14; ++i) {
    const TrackResult a = whole.track(frame(i)), b = next.track(frame(i));
    EXPECT_EQ(a.status, b.status);
    EXPECT_EQ(a.T_WC.matrix(), b.T_WC.matrix()) << i;
    EXPECT_EQ(a.covariance, b.covariance) << i;
  }
  EXPECT_EQ(whole.tracker.keyframe_count(), next.tracker.keyframe_count());
  EXPECT_GT(whole.tracker.keyframe_count(), 2);
  for (int id = 0; id < whole.tracker.keyframe_count(); ++id)
    EXPECT_EQ(whole.tracker.keyframe_pose(id).matrix(), next.tracker.keyframe_pose(id).matrix());

  // What is no state is refused, and the tracker goes on as if nothing had been.
  const std::vector<uint8_t> before = next.tracker.state();
  EXPECT_THROW(next.tracker.restore({}), Error);
  for (const size_t size : {size_t{7}, size_t{40}, state.size() / 2, state.size() - 1})
    EXPECT_THROW(next.tracker.restore(std::span(state).first(size)), Error) << size;
  for (const size_t at : {size_t{3}, size_t{12}, size_t{20}, state.size() / 3}) {
    std::vector<uint8_t> broken = state;
    broken[at] ^= 0x40;
    EXPECT_THROW(next.tracker.restore(broken), Error) << at;
  }
  TrackerOptions other = options_for();
  other.keyframes = 11;
  EXPECT_THROW(Tracking(other).tracker.restore(state), Error);
  EXPECT_EQ(next.tracker.state(), before);
}

TEST(Tracker, ARecordingStartsInTheMapOfAnEarlierOne) {
  ICLK_NEED_DEVICE();
  Tracking earlier, later;
  for (int i = 0; i < 14; ++i) earlier.track(i);
  later.tracker.start_in(earlier.tracker.state());
  const int known = later.tracker.keyframe_count();
  double time = -100;  // another clock
  for (const int i : {3, 4, 5, 13, 14, 15, 16, 17}) {
    TrackFrame frame = Flight::get().frame(i);
    frame.time = ++time;
    const TrackResult r = later.track(frame);
    ASSERT_NE(r.status, TrackStatus::lost) << i << ": " << r.reason;
    EXPECT_EQ(r.map, 0);
    EXPECT_LT(later.error(r, i), 0.3) << i;
  }
  EXPECT_GT(later.tracker.keyframe_count(), known);  // the map grew
}

/// Sets 8 bytes of a state, and the checksum that fits.
std::vector<uint8_t> forged(std::vector<uint8_t> state, size_t at, uint64_t value) {
  std::memcpy(state.data() + at, &value, 8);
  uint64_t h = 0xcbf29ce484222325;
  for (size_t i = 16; i < state.size(); ++i) h = (h ^ state[i]) * 0x100000001b3;
  std::memcpy(state.data() + 8, &h, 8);
  return state;
}

/// A state that fits its checksum, but may contain anything, is refused or used; nothing is read beyond it.
TEST(Tracker, AMaliciousStateDoesNoHarm) {
  ICLK_NEED_DEVICE();
  TrackerOptions options = options_for();
  options.keyframes = 2;
  options.window = 1;
  options.min_visible = 0.95;
  Tracking t(options), victim(options);
  for (int i = 0; i < 6; ++i) t.track(i);
  const std::vector<uint8_t> state = t.tracker.state();
  int refused = 0;
  const auto try_with = [&](size_t at, uint64_t value) {
    try {
      victim.tracker.start_in(forged(state, at, value));
      TrackFrame frame = Flight::get().frame(7);
      frame.time += 1e9;
      victim.track(frame);
    } catch (const Error&) {
      ++refused;
    }
  };
  std::mt19937_64 random(1);
  for (int round = 0; round < 60; ++round) {
    const size_t at = 16 + (round % 2 == 0 ? random() % 80 : random() % (state.size() - 24));
    try_with(at, round % 4 < 2 ? ~uint64_t{0} : random());
  }
  EXPECT_GT(refused, 15);
  // Each count of frames, such as when a keyframe was last used, becomes a large one.
  for (size_t at = 16; at + 8 <= state.size(); ++at) {
    uint64_t value = 0;
    std::memcpy(&value, state.data() + at, 8);
    if (value > 0 && value <= 6) try_with(at, uint64_t{1} << 50);
  }
  Camera other = Flight::get().camera;
  other.fx += 1;
  Tracker with_other(*victim.aligner, other, options);
  EXPECT_THROW(with_other.start_in(state), Error);
}

TEST(Tracker, WhatCannotBeTrackedIsRefused) {
  ICLK_NEED_DEVICE();
  Tracking t;
  for (const double time : {double(NAN), double(INFINITY), -double(INFINITY)}) {
    TrackFrame never = Flight::get().frame(3);
    never.time = time;
    EXPECT_THROW(t.track(never), Error) << time;
  }
  t.track(3);
  EXPECT_THROW(t.track(3), Error);  // no later
  EXPECT_THROW(t.track(2), Error);
  TrackFrame small = Flight::get().frame(5);
  small.image.width = 100;
  EXPECT_THROW(t.track(small), Error);
  TrackFrame masked = Flight::get().frame(5);
  masked.mask = {Flight::get().views[0].rgba.data(), 320, 240, 320, PixelFormat::r8};
  EXPECT_THROW(t.track(masked), Error);
  EXPECT_NE(t.track(5).status, TrackStatus::lost);

  TrackerOptions bad = options_for();
  bad.window = 0;
  EXPECT_THROW(Tracker(*t.aligner, Flight::get().camera, bad), Error);
  for (const DepthSigma sigma : {DepthSigma{}, DepthSigma{.constant = -0.001, .relative = 0.01}, DepthSigma{.constant = NAN}}) {
    bad = options_for();
    bad.depth_sigma = sigma;
    EXPECT_THROW(bad.check(), Error);
  }
  EXPECT_EQ(TrackerOptions().depth_sigma.constant, parse_depth_sigma("structured-light").constant);
  bad = options_for();
  bad.keyframes = 100;  // more than the aligner has slots
  EXPECT_THROW(Tracker(*t.aligner, Flight::get().camera, bad), Error);
}

}  // namespace
}  // namespace iclk::test
