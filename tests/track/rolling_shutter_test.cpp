// Rolling shutters: images of a turning camera in closed form, and a flight whose frames are put together from strips.
#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <iclk/align/device_aligner.h>
#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/track/internal/turn_rate.h>
#include <iclk/track/internal/unroll.h>
#include <iclk/track/tracker.h>

#include "device.h"

namespace iclk::test {
namespace {

using namespace internal;

Eigen::Matrix3d rotation(const Eigen::Vector3d& phi) {
  return SE3::exp((Vector6d() << Eigen::Vector3d::Zero(), phi).finished()).R;
}

/// A world on a sphere of 5 m about the camera.
struct Sphere {
  Camera camera{300, 300, 159.5, 119.5, 320, 240};
  std::vector<float> image, depth;

  explicit Sphere(const Eigen::Vector3d& turn) : Sphere(turn, RowTimes({300, 300, 159.5, 119.5, 320, 240})) {}
  Sphere(const Eigen::Vector3d& turn, const RowTimes& rows) : image(320 * 240), depth(image.size()) {
    for (int v = 0; v < 240; ++v)
      for (int u = 0; u < 320; ++u) {
        const Eigen::Vector3d ray = camera.ray({u, v}), X = rotation(turn * rows.at({u, v})) * ray;
        const size_t at = static_cast<size_t>(v * 320 + u);
        image[at] = static_cast<float>(0.5 + 0.2 * std::sin(25 * X.x() / X.z()) + 0.2 * std::cos(31 * X.y() / X.z()));
        depth[at] = static_cast<float>(5 / ray.norm());
      }
  }
  TrackFrame frame() const {
    return {1.5, {image.data(), 320, 240, 0, PixelFormat::r32f}, {depth.data(), 320, 240, 0, PixelFormat::r32f}, {}};
  }
};

TEST(RollingShutter, ImageAndDepthAreAsOfACameraThatStandsStill) {
  const Eigen::Vector3d turn(0.05, -0.04, 0.06);
  const Sphere still(Eigen::Vector3d::Zero()), rolling(turn);
  FramePixels out;
  unroll(rolling.frame(), rolling.camera, RowTimes(rolling.camera), turn, out);
  EXPECT_EQ(out.time, 1.5);
  ASSERT_EQ(out.format, PixelFormat::r32f);
  const auto* image = reinterpret_cast<const float*>(out.image.data());
  double before = 0, after = 0, mean = 0;
  int masked = 0;
  for (size_t i = 0; i < still.image.size(); ++i) {
    masked += out.mask[i] == 0;
    if (out.mask[i] == 0) continue;
    before = std::max<double>(before, std::abs(rolling.image[i] - still.image[i]));
    after = std::max<double>(after, std::abs(image[i] - still.image[i]));
    mean += std::abs(image[i] - still.image[i]) / static_cast<double>(still.image.size());
    EXPECT_NEAR(out.depth[i], still.depth[i], 0.006) << i;  // half a pixel's, where the sphere is steepest
  }
  EXPECT_GT(before, 0.2);
  EXPECT_LT(after, 0.011);  // half a pixel beyond the border
  EXPECT_LT(mean, 3e-4);
  EXPECT_GT(masked, 100);  // what no row saw
  EXPECT_LT(masked, 8000);

  // Bytes are rounded, a mask moves along, and a camera that stands still changes nothing.
  std::vector<uint8_t> bytes(still.image.size()), mask(bytes.size(), 255);
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<uint8_t>(255 * still.image[i]);
  mask[0] = 0;
  unroll({0, {bytes.data(), 320, 240, 0, PixelFormat::r8}, {}, {mask.data(), 320, 240, 0, PixelFormat::r8}}, still.camera,
         RowTimes(still.camera), Eigen::Vector3d::Zero(), out);
  EXPECT_EQ(out.image, bytes);
  EXPECT_EQ(out.mask, mask);
  EXPECT_TRUE(out.depth.empty());
}

TEST(RollingShutter, FeaturesMoveWithTheirPixels) {
  const Eigen::Vector3d turn(0.05, -0.04, 0.06);
  const Sphere still(Eigen::Vector3d::Zero()), rolling(turn);
  Features read;
  for (int v = 20; v < 240; v += 40)
    for (int u = 20; u < 320; u += 40) {
      read.uv.emplace_back(u, v);
      read.inverse_depth.push_back(1 / rolling.depth[static_cast<size_t>(320 * v + u)]);
      read.inverse_depth_sigma.push_back(0.01 * read.inverse_depth.back());
    }
  read.uv.emplace_back(NAN, 3);  // is not used, and does no harm
  read.inverse_depth.push_back(1);
  read.inverse_depth_sigma.push_back(0);
  TrackFrame frame = rolling.frame();
  frame.features = &read;
  FramePixels out;
  unroll(frame, rolling.camera, RowTimes(rolling.camera), turn, out);
  ASSERT_TRUE(out.features);
  ASSERT_EQ(out.features->size(), read.size());
  double moved = 0;
  for (size_t i = 0; i + 1 < read.uv.size(); ++i) {
    const Eigen::Vector2d& uv = out.features->uv[i];
    moved = std::max(moved, (uv - read.uv[i]).norm());
    EXPECT_NEAR(1 / out.features->inverse_depth[i], 5 / still.camera.ray(uv).norm(), 1e-5) << i;
    EXPECT_NEAR(out.features->inverse_depth_sigma[i], 0.01 * out.features->inverse_depth[i], 1e-12) << i;
    const Eigen::Vector2d back = unrolled_anew(rolling.camera, RowTimes(rolling.camera), turn, Eigen::Vector3d::Zero(), uv);
    EXPECT_LT((back - read.uv[i]).norm(), 2e-2) << i;
  }
  EXPECT_GT(moved, 5);
}

TEST(RollingShutter, ColoursAreResampledChannelByChannel) {
  const Sphere rolling({0.05, -0.04, 0.06});
  const Eigen::Vector3d turn(0.02, 0.03, -0.05);
  const auto straight = [&](const std::vector<uint8_t>& bytes, PixelFormat format) {
    FramePixels out;
    unroll({1.5, {bytes.data(), 320, 240, 0, format}, {}, {}}, rolling.camera, RowTimes(rolling.camera), turn, out);
    return out.image;
  };
  for (const PixelFormat format : {PixelFormat::rgb8, PixelFormat::rgba8}) {
    const auto n = static_cast<size_t>(channels(format));
    std::vector<std::vector<uint8_t>> single(n, std::vector<uint8_t>(rolling.image.size()));
    std::vector<uint8_t> together;
    for (size_t i = 0; i < rolling.image.size(); ++i)
      for (size_t c = 0; c < n; ++c) {
        single[c][i] = static_cast<uint8_t>(200 * rolling.image[i] + 10 * static_cast<double>(c));
        together.push_back(single[c][i]);
      }
    const std::vector<uint8_t> out = straight(together, format);
    for (size_t c = 0; c < n; ++c) {
      const std::vector<uint8_t> alone = straight(single[c], PixelFormat::r8);
      for (size_t i = 0; i < alone.size(); ++i) ASSERT_EQ(out[n * i + c], alone[i]) << c << " of " << n << " at " << i;
    }
  }
}

TEST(RollingShutter, PixelsMoveWithTheTurnAsTheImageDoes) {
  const Camera camera{300, 300, 159.5, 119.5, 320, 240};
  const RowTimes rows(camera);
  const Eigen::Vector3d turn(0.05, -0.04, 0.06), other(-0.01, 0.03, 0.02), none = Eigen::Vector3d::Zero();
  double moved = 0;
  for (double v = 10; v < 230; v += 20)
    for (double u = 10; u < 310; u += 20) {
      const Eigen::Vector2d read(u, v), straight = unrolled_anew(camera, rows, none, turn, read);
      EXPECT_LT((straight - unrolled(camera, turn, read)).norm(), 1e-5) << "of an image as it was read";
      EXPECT_LT((unrolled_anew(camera, rows, turn, none, straight) - read).norm(), 0.03);
      EXPECT_LT((unrolled_anew(camera, rows, turn, other, straight) - unrolled(camera, other, read)).norm(), 0.03);
      moved = std::max(moved, (straight - read).norm());
    }
  EXPECT_GT(moved, 5);
}

TEST(RollingShutter, RowsOfAnImageWhoseLensWasUndoneAreTheCameras) {
  const Eigen::Vector3d turn(0.05, -0.04, 0.06);
  const Camera camera{300, 300, 159.5, 119.5, 320, 240};
  // A lens that bends rows by up to 12 px at the corners.
  const auto time = [&](const Eigen::Vector2d& uv) {
    const double x = (uv.x() - camera.cx) / camera.fx, y = (uv.y() - camera.cy) / camera.fy;
    return std::clamp(row_time(camera, camera.cy + camera.fy * y * (1 - 0.23 * (x * x + y * y))), -0.5, 0.5);
  };
  const RowTimes rows(camera, time), plain(camera);
  double off = 0, bent = 0;
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 320; ++u) {
      off = std::max(off, std::abs(rows.at({u, v}) - time({u, v})));
      bent = std::max(bent, std::abs(rows.at({u, v}) - plain.at({u, v})));
    }
  EXPECT_LT(off, 5e-4) << "an eighth of a row";
  EXPECT_GT(bent, 0.05);
  EXPECT_EQ(rows.at({-50, 300}), rows.at({0, 239}));
  EXPECT_EQ(rows.at({NAN, NAN}), rows.at({0, 0}));

  const Sphere still(Eigen::Vector3d::Zero()), rolling(turn, rows);
  const auto mean_error = [&](const RowTimes& how) {
    FramePixels out;
    unroll(rolling.frame(), camera, how, turn, out);
    double sum = 0;
    for (size_t i = 0; i < still.image.size(); ++i)
      if (out.mask[i] != 0) sum += std::abs(reinterpret_cast<const float*>(out.image.data())[i] - still.image[i]);
    return sum / static_cast<double>(still.image.size());
  };
  EXPECT_LT(mean_error(rows), 4e-4);
  EXPECT_GT(mean_error(plain), 2e-3);
}

TEST(RollingShutter, ReadoutsAreVotedFor) {
  ReadoutEstimate estimate;
  EXPECT_EQ(estimate.seconds(), 0);
  EXPECT_TRUE(std::isinf(estimate.sigma()));
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d rate = Eigen::Vector3d(normal(random), normal(random), normal(random));
    Eigen::Vector3d turn = -0.02 * rate + 0.003 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    if (i % 5 == 0) turn = Eigen::Vector3d(0.5, 0, 0);  // nonsense
    estimate.add(turn, 0.003, rate);
    estimate.add(turn, 0.003, Eigen::Vector3d(1e-3, 0, 0));  // stands still: no vote
    estimate.add(turn * NAN, 0.003, rate);
  }
  EXPECT_NEAR(estimate.seconds(), -0.02, 0.001);
  EXPECT_GT(estimate.sigma(), 1e-5);
  EXPECT_LT(estimate.sigma(), 1e-3);
}

TEST(RollingShutter, RatesAreTakenTogetherByHowSureTheyAre) {
  const TurnRate step{{0.1, 0, -0.2}, 0.1};
  const Eigen::Vector3d seen(0.3, 0.4, -0.2);
  const TurnRate both = step.with(seen, Eigen::Vector3d(0.01, 1e-8, 1e8).asDiagonal());
  EXPECT_LT((both.rate - Eigen::Vector3d(0.2, 0.4, -0.2)).norm(), 1e-6);
  EXPECT_NEAR(both.sigma, std::sqrt((0.005 + 0.01) / 3), 1e-6);

  std::mt19937_64 random(5);
  std::normal_distribution<double> normal(0, 0.2);
  RateChanges changes;
  const double unknown = changes.sigma();
  Eigen::Vector3d rate(3, 0, 0);
  for (int i = 0; i < 400; ++i) {
    if (i % 10 == 5) {
      changes.interrupt();
      rate.x() = -rate.x();
    }
    changes.add(rate);
    EXPECT_EQ(changes.sigma() == unknown, i < 3) << i;
    rate += Eigen::Vector3d(normal(random), normal(random), normal(random));
  }
  EXPECT_NEAR(changes.sigma(), 0.2, 0.05);
  for (int i = 0; i < 1000; ++i) changes.add(rate);
  EXPECT_GT(changes.sigma(), 0);
  EXPECT_LT(changes.sigma(), 0.02) << "what was long ago does not count";
}

/// A camera over terrain, shaken about all axes, whose rows are read in kReadout.
struct ShakenFlight {
  static constexpr int kFrames = 14, kStrip = 20;
  static constexpr double kReadout = 0.05, kStep = 0.1;
  Camera camera{280, 280, 159.5, 119.5, 320, 240};
  std::vector<View> views;
  double shake;  ///< 1: up to 0.6 rad/s an axis

  SE3 pose(double t) const {
    Eigen::Matrix3d down;
    down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    const Eigen::Vector3d phi(0.10 * std::sin(6 * t), 0.12 * std::sin(5 * t + 1), 0.15 * std::sin(4 * t));
    return {down * rotation(shake * phi), Eigen::Vector3d(100 + 12 * t, 110 + 8 * t, 150)};
  }
  /// `depth_error`: of the depth images, relative; of each image its own, smooth over it, as a rig's are.
  explicit ShakenFlight(double shaken = 1, double depth_error = 0) : shake(shaken) {
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> phase(0, 2 * M_PI);
    const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256}));
    TerrainRenderer renderer(device(), terrain);
    for (int i = 0; i < kFrames; ++i) {
      View view = renderer.render(camera, pose(kStep * i));
      for (int v = 0; v < camera.height; v += kStrip) {
        const double late = kReadout * row_time(camera, v + 0.5 * (kStrip - 1));
        const View strip = renderer.render(camera, pose(kStep * i + late));
        const auto from = v * camera.width, to = (v + kStrip) * camera.width;
        std::copy(strip.rgba.begin() + from, strip.rgba.begin() + to, view.rgba.begin() + from);
        std::copy(strip.depth.begin() + from, strip.depth.begin() + to, view.depth.begin() + from);
      }
      const double a = phase(random), b = phase(random);
      for (int v = 0; v < camera.height; ++v)
        for (int u = 0; u < camera.width; ++u)
          view.depth[static_cast<size_t>(v * camera.width + u)] *=
              static_cast<float>(1 + depth_error * (std::sin(0.03 * u + a) + std::sin(0.04 * v + b)));
      views.push_back(std::move(view));
    }
  }
};

struct Shaken {
  double error = 0;  ///< m, worst
  int confirmed = 0;
  double readout = 0;
};

Shaken track_shaken(const ShakenFlight& flight, double readout, double depth_sigma = 0.001) {
  TrackerOptions options;
  options.features = 100;
  options.depth_sigma = {.relative = depth_sigma};
  options.window = 4;
  options.keyframes = 8;
  options.readout = readout;
  AlignerOptions how;
  how.search = true;
  const auto aligner = make_device_aligner(device(), Tracker::plan(flight.camera, options), how, Solver::device);
  Tracker tracker(*aligner, flight.camera, options);
  Shaken out;
  for (int i = 0; i < ShakenFlight::kFrames; ++i) {
    const View& view = flight.views[static_cast<size_t>(i)];
    const TrackResult r = tracker.track({ShakenFlight::kStep * i, view.image(), view.depth_image(), {}});
    out.confirmed += r.confirmed;
    const SE3 truth = flight.pose(0).inverse() * flight.pose(ShakenFlight::kStep * i);
    out.error = std::max(out.error, r.status == TrackStatus::lost ? 1000 : (r.T_WC.t - truth.t).norm());
  }
  out.readout = tracker.readout().seconds;
  return out;
}

TEST(RollingShutter, AShakenCameraIsFollowedAndItsReadoutFound) {
  ICLK_NEED_DEVICE();
  const ShakenFlight flight;
  const Shaken global = track_shaken(flight, 0), right = track_shaken(flight, ShakenFlight::kReadout);
  RecordProperty("global", std::to_string(global.error));
  RecordProperty("right", std::to_string(right.error));
  EXPECT_LT(right.error, 0.5 * global.error) << global.error;
  EXPECT_GE(right.confirmed, ShakenFlight::kFrames - 1);
  EXPECT_NEAR(right.readout, ShakenFlight::kReadout, 0.1 * ShakenFlight::kReadout);
  EXPECT_GT(global.readout, 0.3 * ShakenFlight::kReadout);
  std::printf("[          ] %.2f m with the shutter, %.2f m without; readouts %.1f and %.1f ms\n", right.error, global.error,
              1000 * right.readout, 1000 * global.readout);
}

TEST(RollingShutter, ErrorsOfDepthsAreNotTakenForTurnsThatAddUp) {
  ICLK_NEED_DEVICE();
  const ShakenFlight flight(0.1, 0.02);
  const Shaken global = track_shaken(flight, 0, 0.02), right = track_shaken(flight, ShakenFlight::kReadout, 0.02);
  std::printf("[          ] %.2f m with the shutter, %.2f m without\n", right.error, global.error);
  EXPECT_LT(right.error, 0.75 * global.error);  // 0.9 without regard to the steps between frames
  EXPECT_GE(right.confirmed, ShakenFlight::kFrames - 1);
}

}  // namespace
}  // namespace iclk::test
