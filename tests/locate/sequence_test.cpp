// A flight over a map that lacks a part.
#include <cmath>

#include <gtest/gtest.h>
#include <iclk/engine/error.h>
#include <iclk/locate/internal/pose_graph.h>
#include <iclk/locate/sequence_locator.h>
#include <iclk/render/procedural.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "../apps/render_fixture.h"
#include "../support/device.h"

namespace iclk {
namespace {

using test::looking_down;

const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};
constexpr double kStep = 5;                        // m between frames
constexpr double kGapLeft = 150, kGapRight = 250;  // m, of x
constexpr int kFrames = 44, kBlack = 6;

std::shared_ptr<const Terrain> ground() {
  static const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 5, .size = 384}));
  return terrain;
}

/// The same without pictures from x `left` to `right`.
std::shared_ptr<const Terrain> with_gap(double left, double right) {
  auto map = std::make_shared<Terrain>(*ground());
  for (int v = 0; v < map->mosaic.height; ++v)
    for (int u = 0; u < map->mosaic.width; ++u) {
      const double x = map->mosaic.left + (u + 0.5) * map->mosaic.step_x;
      if (x > left && x < right)
        map->rgba[static_cast<size_t>(v) * static_cast<size_t>(map->mosaic.width) + static_cast<size_t>(u)] = 0;
    }
  return map;
}

/// East, with a gentle swing.
SE3 pose_at(int i) {
  return looking_down({80 + kStep * i, 190 + 10 * std::sin(0.15 * i), 150 + 3 * std::sin(0.1 * i)}, 0.1 * std::sin(0.2 * i),
                      0.1);
}

LocatorOptions classical() {
  LocatorOptions options;
  options.session.model = "classical";
  return options;
}

double nees(const SequencePose& pose, const SE3& truth) {
  const Vector6d xi = (pose.T_WC.inverse() * truth).log();
  return xi.dot(pose.covariance.ldlt().solve(xi));
}

class Sequences : public ::testing::Test {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};

TEST_F(Sequences, FramesWithoutAMapKeepAPose) {
  Locator locator(test::device(), with_gap(kGapLeft, kGapRight), classical());
  SequenceLocator sequence(locator, kCamera);
  TerrainRenderer renderer(test::device(), ground(), {.samples = 1});
  std::vector<SequencePose> live;
  for (int i = 0; i < kFrames; ++i) {
    View view = renderer.render(kCamera, pose_at(i));
    if (i == kBlack) std::fill(view.rgba.begin(), view.rgba.end(), 0xff000000u);
    LocatorFrame frame{0.1 * i, view.image(), {}, {}};
    if (i == 0) frame.prior = LocatePrior{pose_at(0), 5, 5, 0.05, 0.1};
    live.push_back(sequence.locate(frame));
  }
  int in_gap = 0;
  double sum = 0;
  for (const std::vector<SequencePose>& poses : {live, sequence.all()})
    for (int i = 0; i < kFrames; ++i) {
      const SequencePose& pose = poses[static_cast<size_t>(i)];
      SCOPED_TRACE(i);
      EXPECT_EQ(pose.known, i != kBlack) << "a frame that shows nothing has no pose; all others have one";
      if (!pose.known) continue;
      const double off = (pose.T_WC.t - pose_at(i).t).norm();
      const double way = std::max(0.0, pose_at(i).t.x() - (kGapLeft - 30));
      if (pose.located.converged()) {
        EXPECT_GE(pose.covariance.trace(), 0.99 * pose.located.covariance.trace()) << "errors of the map do not average out";
        EXPECT_LT(off, 0.3);
        continue;
      }
      EXPECT_LT(off, 0.01 * way);
      EXPECT_GT(std::sqrt(pose.covariance.topLeftCorner<3, 3>().trace()), 0.01);
      sum += nees(pose, pose_at(i));
      ++in_gap;
    }
  EXPECT_GT(in_gap, 12);
  EXPECT_LT(sum / in_gap, 12) << "the covariance is that of the errors";
}

/// The ground, but what lies from x `left` to `right` is shown `by` metres further north, with its heights.
std::shared_ptr<const Terrain> with_shift(double left, double right, double by) {
  auto map = std::make_shared<Terrain>(*ground());
  const auto shift = [&](const Grid& grid, const auto& from, auto& to) {
    const int rows = static_cast<int>(std::lround(by / grid.step_y));
    for (int v = 0; v + rows < grid.height; ++v)
      for (int u = 0; u < grid.width; ++u) {
        const double x = grid.left + (u + 0.5) * grid.step_x;
        const auto at = [&](int row) {
          return static_cast<size_t>(row) * static_cast<size_t>(grid.width) + static_cast<size_t>(u);
        };
        if (x > left && x < right) to[at(v)] = from[at(v + rows)];
      }
  };
  shift(map->mosaic, ground()->rgba, map->rgba);
  shift(map->relief, ground()->height, map->height);
  return map;
}

/// A part of the map is wrong, and right in itself: frames that see nothing else fit it.
TEST_F(Sequences, PosesThatContradictTheMotionAreDropped) {
  Locator locator(test::device(), with_shift(140, 240, 6), classical());
  SequenceLocator sequence(locator, kCamera);
  TerrainRenderer renderer(test::device(), ground(), {.samples = 1});
  int alone = 0;
  std::vector<SequencePose> live;
  for (int i = 0; i < 28; ++i) {
    const View view = renderer.render(kCamera, pose_at(i));
    LocatorFrame frame{0.1 * i, view.image(), {}, {}};
    if (i == 0) frame.prior = LocatePrior{pose_at(0), 5, 5, 0.05, 0.1};
    live.push_back(sequence.locate(frame));
    if (i < 20) continue;
    const Located single = locator.locate(view.image(), kCamera, {pose_at(i), 5, 5, 0.05, 0.1});
    alone += single.converged() && (single.T_WC.t - pose_at(i).t).norm() > 3;
  }
  EXPECT_GT(alone, 3) << "frames that are wrong alone";
  for (const std::vector<SequencePose>& poses : {live, sequence.all()})
    for (size_t i = 0; i < poses.size(); ++i) {
      if (!poses[i].located.converged()) continue;
      EXPECT_LT((poses[i].T_WC.t - pose_at(static_cast<int>(i)).t).norm(), 1) << i << ' ' << poses[i].located.reason;
    }
}

TEST_F(Sequences, TheFirstFrameNeedsAPrior) {
  Locator locator(test::device(), ground(), classical());
  SequenceLocator sequence(locator, kCamera);
  const std::vector<uint32_t> image(320 * 240);
  try {
    sequence.locate({0, {image.data(), 320, 240, 0, PixelFormat::rgba8}, {}, {}});
    ADD_FAILURE() << "located from nowhere";
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("prior"), std::string::npos) << e.what();
  }
}

SE3 along(double x) { return {Eigen::Matrix3d::Identity(), {x, 0, 0}}; }

/// Ten frames, 1 m apart; the first and the last are anchored.
internal::PoseGraph chain() {
  internal::PoseGraph graph;
  const Matrix6d C = 1e-4 * Matrix6d::Identity();
  for (int i = 0; i < 10; ++i) {
    graph.add();
    if (i > 0) graph.motion({i - 1, i, along(-1.01), C});  // T_to_from; each is 1 cm too long
  }
  graph.anchor(0, along(100), C);
  graph.solve(0, 0);
  return graph;
}

TEST(PoseGraph, UncertaintyGrowsWithTheWayAndEndsAtAnAnchor) {
  internal::PoseGraph graph = chain();
  for (int i = 1; i < 10; ++i) EXPECT_NEAR(graph.pose(i).t.x(), 100 + 1.01 * i, 1e-6);
  for (int i = 1; i < 10; ++i) EXPECT_NEAR(graph.covariance(i)(0, 0), 1e-4 * (i + 1), 2e-5);
  graph.anchor(9, along(109), 1e-4 * Matrix6d::Identity());
  graph.solve(0, 0);
  EXPECT_NEAR(graph.pose(5).t.x(), 105, 0.02);
  EXPECT_LT(graph.covariance(9)(0, 0), 1e-4);
  EXPECT_LT(graph.surprise(9), 2);
}

TEST(PoseGraph, AWrongAnchorIsASurprise) {
  internal::PoseGraph graph = chain();
  graph.anchor(9, along(109), 1e-4 * Matrix6d::Identity());
  graph.anchor(5, along(112), 1e-4 * Matrix6d::Identity());
  graph.solve(0, 0);
  EXPECT_NEAR(graph.pose(5).t.x(), 105, 0.05);
  EXPECT_GT(graph.surprise(5), 100);
  EXPECT_LT(graph.surprise(9), 5);
}

TEST(PoseGraph, FramesWithoutAConnectionStayUnknown) {
  internal::PoseGraph graph;
  for (int i = 0; i < 3; ++i) graph.add();
  graph.motion({0, 1, along(-1), Matrix6d::Identity()});
  graph.anchor(2, along(7), Matrix6d::Identity());
  graph.solve(0, 0);
  EXPECT_FALSE(graph.known(0) || graph.known(1));
  EXPECT_TRUE(graph.known(2));
}

}  // namespace
}  // namespace iclk
