// One rendered view warped onto the other by its own depth and pose: what misalignment is left, and how alike they are.
#include <cstdio>

#include <gtest/gtest.h>

#include <Eigen/LU>

#include <iclk/render/geotiff.h>
#include <iclk/render/procedural.h>

#include "device.h"
#include "files.h"
#include "render_fixture.h"

namespace iclk {
namespace {

/// Catmull-Rom: an interpolation whose own blur and shift are small beside what is measured.
double interpolate(const std::vector<double>& image, int width, int height, double u, double v) {
  const int iu = static_cast<int>(std::floor(u)), iv = static_cast<int>(std::floor(v));
  const auto weights = [](double t, double(&w)[4]) {
    w[0] = 0.5 * t * (-1 + t * (2 - t));
    w[1] = 0.5 * (2 + t * t * (3 * t - 5));
    w[2] = 0.5 * t * (1 + t * (4 - 3 * t));
    w[3] = 0.5 * t * t * (t - 1);
  };
  double a[4], b[4], sum = 0;
  weights(u - iu, a);
  weights(v - iv, b);
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 4; ++i) {
      const int x = std::clamp(iu + i - 1, 0, width - 1), y = std::clamp(iv + j - 1, 0, height - 1);
      sum += a[i] * b[j] * image[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)];
    }
  return sum;
}

struct Agreement {
  double shift = 0;        // px, of the whole image
  double worst_block = 0;  // px, of the blocks of 80x80 pixels
  double ncc = 0;
  double visible = 0;  // share of the pixels of view 0
};

Agreement compare(const Camera& camera, const View& view0, const View& view1, const SE3& T_10) {
  const int w = camera.width, h = camera.height;
  std::vector<double> grey0, grey1, warped(view0.rgba.size()), visible(view0.rgba.size(), 0);
  for (const uint32_t p : view0.rgba) grey0.push_back(test::grey(p));
  for (const uint32_t p : view1.rgba) grey1.push_back(test::grey(p));
  const auto at = [&](int u, int v) { return static_cast<size_t>(v) * static_cast<size_t>(w) + static_cast<size_t>(u); };
  for (int v = 0; v < h; ++v)
    for (int u = 0; u < w; ++u) {
      const Eigen::Vector3d X = T_10 * (camera.ray({u, v}) * view0.depth[at(u, v)]);
      if (X.z() <= 0) continue;
      const Eigen::Vector2d uv = camera.project(X);
      if (!(uv.x() >= 2 && uv.y() >= 2 && uv.x() <= w - 3 && uv.y() <= h - 3)) continue;
      // Visible: all four pixels around have the depth that the point has, so that no edge is near.
      const int iu = static_cast<int>(uv.x()), iv = static_cast<int>(uv.y());
      bool seen = true;
      for (int j = -1; j <= 2; ++j)
        for (int i = -1; i <= 2; ++i) seen = seen && std::abs(view1.depth[at(iu + i, iv + j)] - X.z()) < 0.02 * X.z();
      if (!seen) continue;
      visible[at(u, v)] = 1;
      warped[at(u, v)] = interpolate(grey1, w, h, uv.x(), uv.y());
    }
  Agreement result;
  double n = 0, s0 = 0, s1 = 0, s00 = 0, s11 = 0, s01 = 0;
  for (size_t i = 0; i < grey0.size(); ++i) {
    if (visible[i] == 0) continue;
    n += 1, s0 += grey0[i], s1 += warped[i];
    s00 += grey0[i] * grey0[i], s11 += warped[i] * warped[i], s01 += grey0[i] * warped[i];
  }
  result.visible = n / static_cast<double>(grey0.size());
  result.ncc = (s01 - s0 * s1 / n) / std::sqrt((s00 - s0 * s0 / n) * (s11 - s1 * s1 / n));
  // Least squares: I1 warped - I0 = -grad(I0) . shift.
  const auto shift_of = [&](int u0, int v0, int u1, int v1, double& pixels) {
    Eigen::Matrix2d A = Eigen::Matrix2d::Zero();
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    pixels = 0;
    for (int v = std::max(v0, 1); v < std::min(v1, h - 1); ++v)
      for (int u = std::max(u0, 1); u < std::min(u1, w - 1); ++u) {
        if (visible[at(u, v)] == 0) continue;
        const Eigen::Vector2d g(0.5 * (grey0[at(u + 1, v)] - grey0[at(u - 1, v)]),
                                0.5 * (grey0[at(u, v + 1)] - grey0[at(u, v - 1)]));
        A += g * g.transpose();
        b += g * (grey0[at(u, v)] - warped[at(u, v)]);
        ++pixels;
      }
    return Eigen::Vector2d(A.inverse() * b).norm();
  };
  double pixels = 0;
  result.shift = shift_of(0, 0, w, h, pixels);
  for (int v = 0; v + 80 <= h; v += 80)
    for (int u = 0; u + 80 <= w; u += 80) {
      const double shift = shift_of(u, v, u + 80, v + 80, pixels);
      if (pixels > 3000) result.worst_block = std::max(result.worst_block, shift);
    }
  return result;
}

void expect_warp(std::shared_ptr<const Terrain> terrain, double altitude, double scale) {
  TerrainRenderer renderer(test::device(), terrain);
  const Camera camera{290, 290, 239.5, 159.5, 480, 320};
  const MapBox map = terrain->extent();
  const double x = 0.5 * (map.left + map.right), y = 0.5 * (map.bottom + map.top), ground = *terrain->height_at(x, y);
  const SE3 T_W0 = test::looking_down({x, y, ground + altitude}, 0.3, 0.15);
  Vector6d twists[3];
  twists[0] << 3, -2, 2.5, 0.04, -0.03, 0.05;
  twists[1] << -4, 3, -2, -0.03, 0.05, -0.2;
  twists[2] << 0, 0, 0, 0.05, 0.04, 0.6;
  for (Vector6d& xi : twists) {
    xi.head<3>() *= scale;
    const SE3 T_10 = SE3::exp(xi), T_W1 = T_W0 * T_10.inverse();
    const Agreement a = compare(camera, renderer.render(camera, T_W0), renderer.render(camera, T_W1), T_10);
    EXPECT_GT(a.visible, 0.4);
    EXPECT_GT(a.ncc, 0.99);
    EXPECT_LT(a.shift, 0.05);
    EXPECT_LT(a.worst_block, 0.05);
    ::testing::Test::RecordProperty("ncc", std::to_string(a.ncc));
    std::printf("visible %.3f, NCC %.4f, shift %.4f px, worst block %.4f px\n", a.visible, a.ncc, a.shift, a.worst_block);
  }
}

TEST(RenderWarp, Procedural) {
  ICLK_NEED_DEVICE();
  expect_warp(std::make_shared<Terrain>(procedural_terrain({.seed = 3, .size = 500})), 170, 1);
}

TEST(RenderWarp, SwissAlps) {
  ICLK_NEED_DEVICE();
  const std::string folder = test::data_folder("ortho_swiss_alps");
  if (folder.empty()) GTEST_SKIP() << test::no_data("ortho_swiss_alps");
  expect_warp(std::make_shared<Terrain>(GeoMap(folder + "/rgb.tif", folder + "/dem.tif").whole()), 200, 1);
}

TEST(RenderWarp, Hilltop) {
  ICLK_NEED_DEVICE();
  const std::string folder = test::data_folder("ortho_px4_hilltop");
  if (folder.empty()) GTEST_SKIP() << test::no_data("ortho_px4_hilltop");
  expect_warp(std::make_shared<Terrain>(GeoMap(folder + "/rgb.tif", folder + "/dem.tif").whole()), 80, 0.4);
}

}  // namespace
}  // namespace iclk
