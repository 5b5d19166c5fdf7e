// Lenses against OpenCV's models, and what the device sees through them.
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <opencv2/calib3d.hpp>

#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/session/io/distortion.h>

#include "apps/iclk/io/undistorter.h"
#include "device.h"
#include "files.h"
#include "render_fixture.h"

namespace iclk {
namespace {

using test::expect_error;
using test::looking_down;
using test::make_terrain;
using test::rgb;

const Camera kCamera{180, 178, 95.3, 59.1, 192, 120};

struct Case {
  const char* name;
  const char* distortion;
};
const Case kCases[] = {{"a Kinect", "radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633"},
                       {"EuRoC", "radtan:-0.28340811,0.07395907,0.00019359,1.76187114e-05"},
                       {"a barrel that folds", "radtan:-0.6,0.02,0.0005,-0.0005"},
                       {"a pincushion", "radtan:0.35,0.1,0,0"},
                       {"a fisheye", "equidistant:-0.0218,0.0026,-0.0014,0.0004"},
                       {"a fisheye that folds", "equidistant:-0.6,0.05,0.02,0"}};

/// Pixels of points in the camera's frame, by OpenCV.
Eigen::Vector2d project_by_opencv(const Eigen::Vector3d& X, const Camera& camera, const Distortion& distortion) {
  const std::vector<cv::Point3d> points = {{X.x(), X.y(), X.z()}};
  std::vector<cv::Point2d> pixels;
  if (distortion.model == Distortion::Model::equidistant)
    cv::fisheye::projectPoints(points, pixels, cv::Vec3d(), cv::Vec3d(), camera_matrix(camera), distortion.k);
  else
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), camera_matrix(camera), distortion.k, pixels);
  return {pixels[0].x, pixels[0].y};
}

/// Share of the pixels that no direction comes to, by where OpenCV projects the directions of growing angles.
double dark_share(const Distortion& distortion) {
  double reach = 0;
  for (double r = 1e-3; r < 4; r += 1e-3) {
    const double at = (project_by_opencv({r, 0, 1}, {1, 1, 0, 0, 1, 1}, distortion)).norm();
    if (at < reach) break;
    reach = at;
  }
  int dark = 0;
  for (int v = 0; v < kCamera.height; ++v)
    for (int u = 0; u < kCamera.width; ++u) dark += kCamera.ray({u, v}).head<2>().norm() > reach;
  return dark / (192.0 * 120);
}

TEST(Lens, IsTheInverseOfOpenCvsProjection) {
  for (const Case& c : kCases) {
    SCOPED_TRACE(c.name);
    const Lens lens(parse_distortion(c.distortion));
    double worst = 0;
    int dark = 0;
    for (int v = 0; v < kCamera.height; ++v)
      for (int u = 0; u < kCamera.width; ++u) {
        const auto ray = lens.undistort(kCamera.ray({u, v}).head<2>());
        if (!ray) {
          ++dark;
          continue;
        }
        EXPECT_LT(ray->norm(), lens.radius());
        worst = std::max(
            worst, (project_by_opencv(7 * ray->homogeneous(), kCamera, lens.distortion()) - Eigen::Vector2d(u, v)).norm());
      }
    EXPECT_LT(worst, 1e-9) << "px";
    EXPECT_NEAR(dark / (192.0 * 120), dark_share(lens.distortion()), 0.005);
    if (std::string(c.name).ends_with("folds")) {
      EXPECT_GT(dark, 1000);
    }
  }
}

TEST(Lens, EndsWhereItFoldsBack) {
  // r (1 - r^2 / 3) grows up to a radius of 1, where it is 2 / 3.
  const Lens lens(parse_distortion("radtan:-0.333333333333,0,0,0"));
  EXPECT_NEAR(lens.radius(), 1, 2e-3);
  EXPECT_TRUE(lens.undistort({0.66, 0}));
  EXPECT_FALSE(lens.undistort({0.67, 0}));
  EXPECT_FALSE(lens.undistort({std::nan(""), 0}));
  EXPECT_TRUE(std::isinf(Lens().radius()));
  EXPECT_NEAR(Lens(parse_distortion("equidistant:0,0,0,0")).radius(), std::tan(kWidestAngle), 1e-9);
  const Lens wide(parse_distortion("equidistant:0,0,0,0"));
  EXPECT_TRUE(wide.undistort({0, 1.49}));
  EXPECT_FALSE(wide.undistort({0, 1.51}));
  EXPECT_EQ(wide.undistort({0, 0})->norm(), 0);
  expect_error([] { Lens({Distortion::Model::radtan, {1, 2}}); }, ErrorCode::invalid_argument, {"not 2"});
  expect_error([] { Lens({Distortion::Model::equidistant, {0, 0, 0, NAN}}); }, ErrorCode::invalid_argument, {"finite"});
}

/// Depths on two planes give the direction in which the device looked: its point must be projected onto the pixel.
TEST(Lens, PointsOfRenderedDepthProjectOntoTheirPixels) {
  ICLK_NEED_DEVICE();
  const Grid relief{60, 60, -3000, 3000, 100, 100}, mosaic{2, 2, -3000, 3000, 3000, 3000};
  const Eigen::Vector2d slopes[2] = {{0.6, -0.2}, {-0.2, 0.6}};
  std::vector<TerrainRenderer> renderers;
  for (const Eigen::Vector2d& slope : slopes)
    renderers.emplace_back(test::device(),
                           std::make_shared<Terrain>(make_terrain(
                               relief, mosaic, [&](double x, double y) { return slope.dot(Eigen::Vector2d(x, y)); },
                               [](double, double) { return rgb(90, 120, 150); })),
                           RenderOptions{.samples = 1});
  const SE3 T_WC = looking_down({20, -10, 300}, 0.4, 0.1);
  for (const Case& c : kCases) {
    SCOPED_TRACE(c.name);
    const Lens lens(parse_distortion(c.distortion));
    const View a = renderers[0].render(kCamera, T_WC, lens), b = renderers[1].render(kCamera, T_WC, lens);
    double worst = 0;
    int dark = 0, disagree = 0;
    for (int v = 0; v < kCamera.height; ++v)
      for (int u = 0; u < kCamera.width; ++u) {
        const size_t at = static_cast<size_t>(v * kCamera.width + u);
        const auto ray = lens.undistort(kCamera.ray({u, v}).head<2>());
        dark += a.depth[at] == 0;
        disagree += (a.depth[at] > 0) != ray.has_value();
        if (!(a.depth[at] > 0 && b.depth[at] > 0)) continue;
        // n . (C + z d) = 0 of both planes, d = R (x, y, 1).
        Eigen::Matrix2d A;
        Eigen::Vector2d r;
        for (int i = 0; i < 2; ++i) {
          const Eigen::Vector3d n(-slopes[i].x(), -slopes[i].y(), 1), m = T_WC.R.transpose() * n;
          A.row(i) = m.head<2>();
          r[i] = -n.dot(T_WC.t) / static_cast<double>((i ? b : a).depth[at]) - m.z();
        }
        const Eigen::Vector2d xy = A.inverse() * r;
        worst = std::max(worst,
                         (project_by_opencv(static_cast<double>(a.depth[at]) * xy.homogeneous(), kCamera, lens.distortion()) -
                          Eigen::Vector2d(u, v))
                             .norm());
      }
    std::printf("[          ] %s: %.2g px, %.1f %% dark\n", c.name, worst, 100.0 * dark / (192 * 120));
    EXPECT_LT(worst, 1e-3) << "px";
    EXPECT_NEAR(dark / (192.0 * 120), dark_share(lens.distortion()), 0.005);
    EXPECT_LE(disagree, 192 * 120 / 1000) << "at the very edge of the domain only";
  }
}

/// Colours come from where depth does: waves on the ground, seen through the lens, have the phase of their place.
TEST(Lens, ColoursLieWhereDepthDoes) {
  ICLK_NEED_DEVICE();
  const auto wave = [](double x, double y) {
    return Eigen::Vector2d(128 + 90 * std::sin(2 * M_PI * x / 12), 128 + 90 * std::sin(2 * M_PI * y / 9));
  };
  const Terrain terrain = make_terrain(
      {40, 40, -200, 200, 10, 10}, {1600, 1600, -200, 200, 0.25, 0.25}, [](double, double) { return 0.0; },
      [&](double x, double y) { return rgb(wave(x, y).x(), wave(x, y).y(), 77); });
  TerrainRenderer renderer(test::device(), std::make_shared<Terrain>(terrain));
  const SE3 T_WC = looking_down({3, -5, 90}, 0.3, 0.1);
  for (const Case& c : kCases) {
    SCOPED_TRACE(c.name);
    const Lens lens(parse_distortion(c.distortion));
    const View view = renderer.render(kCamera, T_WC, lens);
    double sum = 0, worst = 0;
    int count = 0;
    for (int v = 0; v < kCamera.height; ++v)
      for (int u = 0; u < kCamera.width; ++u) {
        const auto ray = lens.undistort(kCamera.ray({u, v}).head<2>());
        const uint32_t p = view.rgba[static_cast<size_t>(v * kCamera.width + u)];
        if (!ray || ray->norm() > 0.8 * std::min(lens.radius(), 1.2)) continue;  // beyond, a pixel covers much ground
        const Eigen::Vector3d X =
            T_WC * (static_cast<double>(view.depth[static_cast<size_t>(v * kCamera.width + u)]) * ray->homogeneous());
        const Eigen::Vector2d expected = wave(X.x(), X.y());
        const double off = std::max(std::abs(test::red(p) - expected.x()), std::abs(test::green(p) - expected.y()));
        worst = std::max(worst, off), sum += off;
        ++count;
      }
    EXPECT_GT(count, 8000);
    EXPECT_LT(sum / count, 2.5);
    EXPECT_LT(worst, 25);
  }
}

TEST(Lens, WindowsShowWhatTheWholeShows) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<Terrain>(procedural_terrain({.seed = 5, .size = 200}));
  const Camera camera{110, 110, 79.5, 59.5, 160, 120};
  const double ground = *terrain->height_at(100, 100);
  TerrainRenderer whole(test::device(), terrain), windows(test::device(), terrain, {.max_texels = 300000});
  ASSERT_FALSE(windows.resident());
  for (const Case& c : kCases) {
    SCOPED_TRACE(c.name);
    const Lens lens(parse_distortion(c.distortion));
    const SE3 T_WC = looking_down({100, 100, ground + 50}, 0.5, 0.1);
    const View a = whole.render(camera, T_WC, lens), b = windows.render(camera, T_WC, lens);
    EXPECT_EQ(a.depth, b.depth);
    int differ = 0;
    for (size_t i = 0; i < a.rgba.size(); ++i) differ += a.rgba[i] != b.rgba[i];
    std::printf("[          ] %s: %d differ\n", c.name, differ);
    EXPECT_LE(differ, 160 * 120 / 1000);
  }
}

TEST(Lens, NoDistortionIsThePinhole) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<Terrain>(procedural_terrain({.seed = 5, .size = 200}));
  TerrainRenderer renderer(test::device(), terrain);
  const SE3 T_WC = looking_down({100, 100, *terrain->height_at(100, 100) + 50}, 0.5, 0.1);
  const View a = renderer.render(kCamera, T_WC), b = renderer.render(kCamera, T_WC, Lens(parse_distortion("radtan:0,0,0,0")));
  for (size_t i = 0; i < a.depth.size(); ++i) ASSERT_NEAR(a.depth[i], b.depth[i], 2e-4 * a.depth[i]) << i;
}

/// A rolling shutter: each row is the row of a view from its own pose.
TEST(Renderer, RowsHaveTheirOwnPoses) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<Terrain>(procedural_terrain({.seed = 5, .size = 200}));
  const Camera camera{60, 60, 31.5, 23.5, 64, 48};
  TerrainRenderer renderer(test::device(), terrain), windows(test::device(), terrain, {.max_texels = 150000});
  const Lens lens(parse_distortion("radtan:-0.2,0.05,0,0"));
  const double ground = *terrain->height_at(100, 100);
  std::vector<SE3> poses;
  for (int v = 0; v < 48; ++v) poses.push_back(looking_down({100 + 0.2 * v, 100, ground + 40}, 0.01 * v));
  const View rows = renderer.render_rows(camera, poses, lens);
  for (const int v : {0, 17, 47}) {
    const View whole = renderer.render(camera, poses[static_cast<size_t>(v)], lens);
    for (int u = 0; u < 64; ++u) {
      ASSERT_EQ(rows.rgba[static_cast<size_t>(64 * v + u)], whole.rgba[static_cast<size_t>(64 * v + u)]) << u << ", " << v;
      ASSERT_EQ(rows.depth[static_cast<size_t>(64 * v + u)], whole.depth[static_cast<size_t>(64 * v + u)]) << u << ", " << v;
    }
  }
  expect_error([&] { windows.render_rows(camera, poses); }, ErrorCode::unsupported, {"rolling", "800x800"});
  poses.pop_back();
  expect_error([&] { renderer.render_rows(camera, poses); }, ErrorCode::invalid_argument, {"47 poses", "48 rows"});
}

}  // namespace
}  // namespace iclk
