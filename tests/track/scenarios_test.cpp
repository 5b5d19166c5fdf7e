// Recordings as they happen: the light changes, the lens is covered, frames blur or are missing. A second tracker continues
// each from the state in the middle.
#include <random>

#include "small_flight.h"

namespace iclk::test {
namespace {

using How = Shot::How;

std::shared_ptr<const Terrain> wide_terrain() {
  static const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 512}));
  return terrain;
}

/// Flies on in a straight line.
void go(std::vector<Shot>& shots, double to_x, double to_y, int frames, How how = How::clear, double seconds = 0.1) {
  const Eigen::Vector3d from = shots.back().T_WC.t;
  for (int i = 1; i <= frames; ++i) {
    const double s = static_cast<double>(i) / frames;
    shots.push_back({looking_down(from.x() + s * (to_x - from.x()), from.y() + s * (to_y - from.y())), how, seconds});
  }
}

Flown fly_and_continue(const std::vector<Shot>& shots) { return fly(wide_terrain(), shots, small_options(), shots.size() / 2); }

TEST(Scenarios, ACorridorIsWalkedBackInOtherLight) {
  ICLK_NEED_DEVICE();
  std::vector<Shot> shots = {{looking_down(100, 256)}};
  go(shots, 400, 256, 50);
  go(shots, 100, 256, 50, How::dim);
  const Flown flown = fly_and_continue(shots);
  EXPECT_EQ(flown.lost, 0);
  EXPECT_EQ(flown.maps, 1);
  EXPECT_GE(flown.loops, 2u);
  EXPECT_LT(flown.errors.back(), 1);
}

TEST(Scenarios, ACameraIsCarriedAwayAndBack) {
  ICLK_NEED_DEVICE();
  std::vector<Shot> shots = {{looking_down(100, 100)}};
  go(shots, 150, 100, 12);
  go(shots, 350, 350, 20, How::covered);
  go(shots, 400, 350, 12);
  go(shots, 120, 100, 20, How::covered);
  go(shots, 160, 100, 10);
  const Flown flown = fly_and_continue(shots);
  EXPECT_LT(flown.worst, 2);
  EXPECT_EQ(flown.maps, 2);
  EXPECT_LE(flown.lost, 43);
  EXPECT_EQ(flown.maps_of.back(), 0) << "the place is known";
}

TEST(Scenarios, ACameraJumps) {
  ICLK_NEED_DEVICE();
  std::vector<Shot> shots = {{looking_down(100, 100)}};
  go(shots, 150, 100, 12);
  shots.push_back({looking_down(350, 350)});
  go(shots, 400, 350, 12);
  shots.push_back({looking_down(120, 100)});
  go(shots, 160, 100, 10);
  const Flown flown = fly_and_continue(shots);
  EXPECT_LT(flown.worst, 2);
  EXPECT_LE(flown.lost, 3);
}

TEST(Scenarios, TenSecondsBlur) {
  ICLK_NEED_DEVICE();
  std::vector<Shot> shots = {{looking_down(150, 256)}};
  go(shots, 200, 256, 12);
  go(shots, 230, 256, 50, How::blurred, 0.2);
  go(shots, 150, 256, 20);
  const Flown flown = fly_and_continue(shots);
  EXPECT_LT(flown.worst, 5);
  EXPECT_EQ(flown.maps_of.back(), 0);
}

TEST(Scenarios, AThirdOfTheFramesIsMissing) {
  ICLK_NEED_DEVICE();
  std::vector<Shot> all = {{looking_down(100, 256)}}, shots;
  go(all, 400, 256, 100);
  std::mt19937 random(1);
  double seconds = 0;
  for (Shot& shot : all) {
    seconds += shot.seconds;
    if (random() % 10 < 3) continue;
    shot.seconds = std::exchange(seconds, 0);
    shots.push_back(shot);
  }
  const Flown flown = fly_and_continue(shots);
  EXPECT_EQ(flown.lost, 0);
  EXPECT_LT(flown.worst, 5);
}

TEST(Scenarios, TwoRoomsAreJoinedLate) {
  ICLK_NEED_DEVICE();
  std::vector<Shot> shots = {{looking_down(120, 256)}};
  go(shots, 170, 256, 12);
  go(shots, 350, 256, 20, How::covered);
  go(shots, 400, 256, 12);
  go(shots, 130, 256, 45);
  const Flown flown = fly_and_continue(shots);
  EXPECT_EQ(flown.maps, 1);
  EXPECT_LE(flown.lost, 22);
  EXPECT_LT(flown.worst, 5);
}

}  // namespace
}  // namespace iclk::test
