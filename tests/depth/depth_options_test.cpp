#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include <iclk/depth/depth_options.h>
#include <iclk/depth/internal/speckles.h>
#include <iclk/engine/error.h>

namespace iclk::test {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN(), kInfinity = std::numeric_limits<double>::infinity();

TEST(DepthOptions, EveryValueHasARange) {
  EXPECT_NO_THROW(DepthOptions().check());
  EXPECT_NO_THROW((DepthPlan{640, 480, 128, 1}.check()));
  for (const DepthPlan& plan : {DepthPlan{15, 480, 128, 1},
                                {640, 0, 128, 1},
                                {640, 480, 120, 1},
                                {640, 480, 0, 1},
                                {640, 480, 272, 1},
                                {640, 480, 128, 0},
                                {640, 480, 128, 9},
                                {4096, 480, 256, 1}})
    EXPECT_THROW(plan.check(), Error) << plan.width << " " << plan.height << " " << plan.planes << " " << plan.views;
  const auto bad = [](auto change) {
    DepthOptions options;
    change(options);
    EXPECT_THROW(options.check(), Error);
  };
  bad([](auto& o) { o.p1 = 0; });
  bad([](auto& o) { o.p2 = o.p1; });
  bad([](auto& o) { o.p2 = 221; });
  bad([](auto& o) { o.edge = kNan; });
  bad([](auto& o) { o.uniqueness = -0.1; });
  bad([](auto& o) { o.tolerance = kInfinity; });
  bad([](auto& o) { o.iterations = 21; });
  bad([](auto& o) { o.speckle = -1; });
}

TEST(DepthOptions, RangesOfDepth) {
  EXPECT_NO_THROW((DepthRange{1, kInfinity}.check()));
  for (const DepthRange& range : {DepthRange{0, 5}, {kNan, 5}, {5, 5}, {5, 1}, {1, kNan}, {-1, 5}})
    EXPECT_THROW(range.check(), Error);
  const std::vector<double> w = {0.5, kNan, 0.25, -1, kInfinity, 0};
  const DepthRange range = range_of(w, 0.25);
  EXPECT_NEAR(range.near, 1 / (0.5 * 1.25), 1e-12);
  EXPECT_NEAR(range.far, 1.25 / 0.25, 1e-12);
  EXPECT_THROW(range_of(std::vector<double>{kNan, -1}), Error);
}

TEST(DepthOptions, PlanesFollowTheMotionOfPixels) {
  const Camera camera{100, 100, 79.5, 59.5, 160, 120};
  SE3 T;
  T.t = {-0.5, 0, 0};                                                                         // 50 px of disparity at 1 m
  EXPECT_EQ(planes_for(camera, std::vector{camera}, std::vector{T}, {1, kInfinity}, 1), 64);  // 51, in sixteens
  EXPECT_EQ(planes_for(camera, std::vector{camera}, std::vector{T}, {1, kInfinity}, 0.5), 112);
  EXPECT_EQ(planes_for(camera, std::vector{camera}, std::vector{T}, {1, kInfinity}, 0.01), 256);
}

TEST(Speckles, SmallIslandsGoLargeOnesStay) {
  // Two islands of a value each, 3 and 5 pixels; a jump of 0.5 parts them.
  std::vector<float> map = {1, 1, 1.5f, 1.5f, 0,  //
                            1, 0, 1.5f, 1.5f, 1.5f};
  internal::drop_speckles(map, 5, 4, 0.2f);
  EXPECT_EQ(map, (std::vector<float>{0, 0, 1.5f, 1.5f, 0, 0, 0, 1.5f, 1.5f, 1.5f}));
}

}  // namespace
}  // namespace iclk::test
