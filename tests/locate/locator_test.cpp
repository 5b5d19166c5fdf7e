// Pictures of a rendered map, found again from priors that are off.
#include <cmath>

#include <gtest/gtest.h>
#include <iclk/engine/error.h>
#include <iclk/locate/locator.h>
#include <iclk/render/procedural.h>
#include <Eigen/Cholesky>

#include "../apps/render_fixture.h"
#include "../support/device.h"

namespace iclk {
namespace {

using test::looking_down;

const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};

LocatorOptions classical() {
  LocatorOptions options;
  options.session.model = "classical";
  return options;
}

std::shared_ptr<const Terrain> village(uint64_t seed) {
  return std::make_shared<const Terrain>(procedural_terrain({.seed = seed, .size = 256}));
}

/// As a camera with another exposure sees it, with finer sampling than the locator's views.
View picture(const std::shared_ptr<const Terrain>& map, const SE3& T_WC) {
  View view = TerrainRenderer(test::device(), map, {.samples = 3}).render(kCamera, T_WC);
  for (uint32_t& p : view.rgba) {
    const auto darker = [&](int c) { return static_cast<uint32_t>(0.8 * (p >> 8 * c & 255) + 10) << 8 * c; };
    p = darker(0) | darker(1) | darker(2) | 0xff000000u;
  }
  return view;
}

SE3 above(const Terrain& map, double x, double y, double height, double heading = 0, double tilt = 0) {
  return looking_down({x, y, map.height_at(x, y).value() + height}, heading, tilt);
}

double metres(const Located& located, const SE3& truth) { return (located.T_WC.t - truth.t).norm(); }

class Locating : public ::testing::Test {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
  std::shared_ptr<const Terrain> map_ = village(3);
};

TEST_F(Locating, FromAPriorOfTwelveMetresAndEightDegrees) {
  Locator locator(test::device(), map_, classical());
  for (int i = 0; i < 4; ++i) {
    const SE3 truth = above(*map_, 110 + 12 * i, 150 - 9 * i, 60, 0.5 * i, 0.1);
    LocatePrior prior{truth, 8, 4, 0.07, 0.1};
    prior.T_WC.t += Eigen::Vector3d(8 * std::cos(i), 8 * std::sin(i), i % 2 ? 3 : -3);
    prior.T_WC.R = prior.T_WC.R * Eigen::AngleAxisd(0.14, Eigen::Vector3d(1, i - 1, 1).normalized()).toRotationMatrix();
    const Located located = locator.locate(picture(map_, truth).image(), kCamera, prior);
    ASSERT_TRUE(located.converged()) << located.reason;
    EXPECT_LT(metres(located, truth), 0.1);
    EXPECT_GT(located.covariance.trace(), 0);
  }
}

/// The same ground with pixels four times larger, which are 0.3 of them off, and heights that are up to half a metre off.
Terrain worse(const Terrain& map) {
  constexpr int n = 4;
  Terrain out = map;
  Grid& m = out.mosaic;
  m = {m.width / n, m.height / n, m.left + 0.3 * n * m.step_x, m.top, n * m.step_x, n * m.step_y};
  for (int v = 0; v < m.height; ++v)
    for (int u = 0; u < m.width; ++u) {
      uint32_t mean[3] = {n * n / 2, n * n / 2, n * n / 2};
      for (int i = 0; i < n * n; ++i)
        for (int c = 0; c < 3; ++c)
          mean[c] += map.rgba[static_cast<size_t>((n * v + i / n) * map.mosaic.width + n * u + i % n)] >> 8 * c & 255;
      out.rgba[static_cast<size_t>(v * m.width + u)] =
          0xff000000u | mean[0] / (n * n) | mean[1] / (n * n) << 8 | mean[2] / (n * n) << 16;
    }
  out.rgba.resize(static_cast<size_t>(m.width * m.height));
  for (size_t i = 0; i < out.height.size(); ++i)
    out.height[i] += 0.5f * static_cast<float>(std::sin(0.37 * static_cast<double>(i)));
  return out;
}

TEST_F(Locating, TheCovarianceCoversErrorsOfTheMap) {
  Locator locator(test::device(), std::make_shared<const Terrain>(worse(*map_)), classical());
  double squared = 0;
  for (int i = 0; i < 4; ++i) {
    const SE3 truth = above(*map_, 110 + 12 * i, 150 - 9 * i, 60, 0.5 * i, 0.1);
    const Located located = locator.locate(picture(map_, truth).image(), kCamera, {truth, 3, 3, 0.05, 0.05});
    ASSERT_TRUE(located.converged()) << located.reason;
    EXPECT_LT(metres(located, truth), 1.5);
    const Vector6d xi = (located.T_WC.inverse() * truth).log();
    squared += xi.dot(located.covariance.ldlt().solve(xi)) / 4;
  }
  EXPECT_LT(squared, 12.6);  // of six degrees of freedom, in 95 of 100 cases
  EXPECT_GT(squared, 0.6);
}

TEST_F(Locating, WithoutAHeading) {
  Locator locator(test::device(), map_, classical());
  const SE3 truth = above(*map_, 128, 120, 60, 2.4);
  LocatePrior prior{above(*map_, 124, 123, 60), 4, 0, 0.02, M_PI};
  const Located located = locator.locate(picture(map_, truth).image(), kCamera, prior);
  ASSERT_TRUE(located.converged()) << located.reason;
  EXPECT_LT(metres(located, truth), 0.1);
  prior.heading_sigma = 0.1;
  EXPECT_FALSE(locator.locate(picture(map_, truth).image(), kCamera, prior).converged());
}

TEST_F(Locating, APoseThatStillMovesIsNotClaimed) {
  LocatorOptions options = classical();
  options.rounds = 1, options.tolerance = 1e-9;
  Locator locator(test::device(), map_, options);
  const SE3 truth = above(*map_, 128, 120, 60);
  const Located located = locator.locate(picture(map_, truth).image(), kCamera, {above(*map_, 126, 123, 62), 2, 2, 0.02, 0.02});
  EXPECT_EQ(located.status, Status::max_iterations) << located.reason;
  EXPECT_TRUE(located.covariance.isZero());
}

TEST_F(Locating, APictureOfAnotherPlaceIsNotClaimed) {
  Locator locator(test::device(), map_, classical());
  const auto elsewhere = village(8);
  for (int i = 0; i < 4; ++i) {
    const double x = 100 + 15 * i;
    const View seen = picture(elsewhere, above(*elsewhere, x, 128, 60, i));
    const LocatePrior prior{above(*map_, x, 128, 60), 10, 5, 0.1, 0.2};
    const Located located = locator.locate(seen.image(), kCamera, prior);
    EXPECT_FALSE(located.converged()) << located.reason;
    EXPECT_TRUE(located.covariance.isZero());
  }
}

TEST_F(Locating, HiddenPixelsAreNotUsed) {
  Locator locator(test::device(), map_, classical());
  const SE3 truth = above(*map_, 128, 120, 60);
  View seen = picture(map_, truth);
  const View elsewhere = picture(map_, above(*map_, 150, 160, 60));
  std::vector<uint8_t> mask(seen.rgba.size(), 255);
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 140; ++u) {  // part of another picture, fixed to the camera
      const size_t at = static_cast<size_t>(v) * 320 + static_cast<size_t>(u);
      seen.rgba[at] = elsewhere.rgba[at], mask[at] = 0;
    }
  const LocatePrior prior{above(*map_, 126, 123, 62), 2, 2, 0.02, 0.02};
  const Located located = locator.locate(seen.image(), kCamera, prior, {mask.data(), 320, 240, 0, PixelFormat::r8});
  ASSERT_TRUE(located.converged()) << located.reason;
  EXPECT_LT(metres(located, truth), 0.1);
  const Located all = locator.locate(seen.image(), kCamera, prior);
  EXPECT_TRUE(!all.converged() || metres(all, truth) < 0.1) << all.reason;
}

// Two quarters of a map that look alike: whichever fits, the other does, too.
TEST_F(Locating, APictureThatFitsTwiceIsAmbiguous) {
  const double period = 64;
  const auto twice = std::make_shared<Terrain>(*map_);
  const auto repeat = [&](const Grid& grid, auto& values) {
    const int columns = static_cast<int>(std::lround(period / grid.step_x));
    for (int v = 0; v < grid.height; ++v)
      for (int u = columns; u < grid.width; ++u) values[v * grid.width + u] = values[v * grid.width + u % columns];
  };
  repeat(twice->relief, twice->height);
  repeat(twice->mosaic, twice->rgba);
  Locator locator(test::device(), twice, classical());
  const SE3 truth = above(*twice, 96, 128, 40);
  const View seen = picture(twice, truth);
  const LocatePrior narrow{truth, 2, 1, 0.02, 0.02};
  const Located sure = locator.locate(seen.image(), kCamera, narrow);
  EXPECT_TRUE(sure.converged()) << sure.reason;
  const LocatePrior wide{truth, 35, 1, 0.02, 0.02};
  const Located unsure = locator.locate(seen.image(), kCamera, wide);
  EXPECT_EQ(unsure.status, Status::ambiguous) << unsure.reason;
  ASSERT_FALSE(unsure.rivals.empty());
  EXPECT_NEAR((unsure.rivals[0].t - unsure.T_WC.t).norm(), period, 0.5);
}

TEST_F(Locating, NoMapUnderThePicture) {
  Locator locator(test::device(), map_, classical());
  const View seen = picture(map_, above(*map_, 128, 128, 60));
  const auto status = [&](const SE3& T_WC, const char* reason) {
    const Located located = locator.locate(seen.image(), kCamera, {T_WC, 10, 10, 0.05, 0.1});
    EXPECT_EQ(located.status, Status::low_overlap);
    EXPECT_EQ(located.reason, reason);
  };
  status(looking_down({2000, 2000, 100}), "the map shows too little where the prior looks");
  status(looking_down({128, 128, -500}), "the prior is below the ground of the map");
}

TEST_F(Locating, BadInputIsRefused) {
  Locator locator(test::device(), map_, classical());
  const View seen = picture(map_, above(*map_, 128, 128, 60));
  LocatePrior prior{above(*map_, 128, 128, 60), 5, 5, 0.05, 0.1};
  const auto refused = [&](const Camera& camera, const LocatePrior& bad) {
    EXPECT_THROW(locator.locate(seen.image(), camera, bad), Error);
  };
  refused({300, 300, 159.5, 119.5, 640, 480}, prior);
  refused({0, 300, 159.5, 119.5, 320, 240}, prior);
  LocatePrior nan = prior;
  nan.T_WC.t.x() = NAN;
  refused(kCamera, nan);
  LocatePrior negative = prior;
  negative.tilt_sigma = -1;
  refused(kCamera, negative);
  LocatePrior huge = prior;
  huge.position_sigma = 1e6;
  refused(kCamera, huge);
  LocatorOptions bad = classical();
  bad.candidates = 0;
  EXPECT_THROW(Locator(test::device(), map_, bad), Error);
}

}  // namespace
}  // namespace iclk
