// iclk_embed as a user runs it: its verdict, and what it has drawn.
#include <algorithm>
#include <sstream>

#include <opencv2/imgproc.hpp>

#include <iclk/render/procedural.h>

#include "apps/embed/flight.h"

#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

/// Pixels of exactly this colour (BGR): terrain has none of the marks' colours.
cv::Mat marks(const cv::Mat& picture, const cv::Scalar& bgr) {
  cv::Mat mask;
  cv::inRange(picture, bgr, bgr, mask);
  return mask;
}

/// Where the camera of frame 3 sees the ground that the one of frame 2 sees at these pixels, by the terrain and the flight
/// alone: no depth that was rendered and no pose that was found has a part in it.
std::vector<Eigen::Vector2d> true_places(const std::vector<Eigen::Vector2d>& pixels, int width, int height) {
  const Terrain terrain = procedural_terrain({.seed = 1, .size = 512});
  const Camera camera{0.9 * width, 0.9 * width, 0.5 * (width - 1), 0.5 * (height - 1), width, height};
  const SE3 T_W0 = embed::camera_pose(terrain, 2), T_1W = embed::camera_pose(terrain, 3).inverse();
  std::vector<Eigen::Vector2d> places;
  for (const Eigen::Vector2d& uv : pixels) {
    const auto above = [&](double z) {
      const Eigen::Vector3d X = T_W0 * (camera.ray(uv) * z);
      const auto ground = terrain.height_at(X.x(), X.y());
      return !ground || X.z() > *ground;
    };
    double z = 20;
    while (z < 500 && above(z)) z += 0.5;
    double before = z - 0.5;
    for (int i = 0; i < 30; ++i) (above((before + z) / 2) ? before : z) = (before + z) / 2;
    places.push_back(camera.project(T_1W * (T_W0 * (camera.ray(uv) * z))));
  }
  return places;
}

/// Centres of the crosses that are whole and alone.
std::vector<Eigen::Vector2d> crosses_in(const cv::Mat& mask) {
  cv::Mat labels, stats, centres;
  const int count = cv::connectedComponentsWithStats(mask, labels, stats, centres);
  std::vector<Eigen::Vector2d> out;
  for (int i = 1; i < count; ++i)
    if (stats.at<int>(i, cv::CC_STAT_AREA) == 17) out.emplace_back(centres.at<double>(i, 0), centres.at<double>(i, 1));
  return out;
}

const cv::Scalar kGreen(0, 255, 0), kRed(0, 0, 255), kMagenta(255, 0, 255);

TEST(Embed, EveryPoseIsRightAndDrawn) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string file = folder.path("last.png");
  const Finished f = run({"--validate", "--frames", "3", "--size", "320x240", "--out", file});
  EXPECT_EQ(f.code, 0) << f.out << f.err;
  EXPECT_EQ(f.err.find("validation:"), std::string::npos) << f.err;
  EXPECT_NE(f.out.find("validation  0 messages"), std::string::npos) << f.out;
  EXPECT_NE(f.out.find("one frame"), std::string::npos) << f.out;

  // The table: each frame begins pixels away from the truth and ends on it.
  std::istringstream lines(f.out);
  int frames = 0;
  for (std::string line, status; std::getline(lines, line);) {
    std::istringstream words(line);
    double number, start, error, metres, degrees;
    if (!(words >> number >> start >> error >> metres >> degrees >> status)) continue;
    ++frames;
    EXPECT_GT(start, 5) << line;
    EXPECT_LT(error, 0.1) << line;
    EXPECT_LT(metres, 0.5) << line;
    EXPECT_EQ(status, "converged") << line;
  }
  EXPECT_EQ(frames, 3) << f.out;

  const cv::Mat picture = cv::imread(file);
  ASSERT_EQ(picture.size(), cv::Size(640, 240));
  const cv::Mat reference = picture.colRange(0, 320), target = picture.colRange(320, 640);
  EXPECT_GT(cv::countNonZero(marks(reference, kGreen)), 300) << "a cross has 17 pixels";
  EXPECT_EQ(cv::countNonZero(marks(reference, kMagenta)), 0);
  EXPECT_EQ(cv::countNonZero(marks(picture, kRed)), 0) << "red says that the alignment failed";
  // Around the centre of a ring, which the truth places, lies the centre of a cross, which the result buffer places.
  cv::Mat crosses = marks(target, kGreen), rings = marks(target, kMagenta);
  cv::Mat labels, stats, centres;
  const int count = cv::connectedComponentsWithStats(rings, labels, stats, centres);
  const std::vector<Eigen::Vector2d> places = true_places(crosses_in(marks(reference, kGreen)), 320, 240);
  ASSERT_GE(places.size(), 30u);
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();
  int whole = 0;
  for (int i = 1; i < count; ++i) {
    const cv::Rect box(stats.at<int>(i, cv::CC_STAT_LEFT), stats.at<int>(i, cv::CC_STAT_TOP),
                       stats.at<int>(i, cv::CC_STAT_WIDTH), stats.at<int>(i, cv::CC_STAT_HEIGHT));
    if (box.width < 16 || box.width > 18 || box.height < 16 || box.height > 18) continue;  // cut off, or two that touch
    ++whole;
    const Eigen::Vector2d ring(box.x + 0.5 * (box.width - 1), box.y + 0.5 * (box.height - 1));
    const Eigen::Vector2d away = *std::min_element(places.begin(), places.end(), [&](const auto& a, const auto& b) {
      return (a - ring).squaredNorm() < (b - ring).squaredNorm();
    }) - ring;
    EXPECT_LT(away.norm(), 1.5) << "ring at " << ring.transpose();
    offset += away;
    const cv::Moments m = cv::moments(crosses(box), true);
    ASSERT_GT(m.m00, 10) << "no cross in the ring at " << box.x << ", " << box.y;
    EXPECT_NEAR(m.m10 / m.m00, 0.5 * (box.width - 1), 1.1);
    EXPECT_NEAR(m.m01 / m.m00, 0.5 * (box.height - 1), 1.1);
  }
  EXPECT_GE(whole, 15);
  // Ring and cross would move together if the shader had a wrong depth.
  EXPECT_LT((offset / whole).norm(), 0.35) << "rings lie beside the true places: " << (offset / whole).transpose();
}

TEST(Embed, ErrorsAreSaid) {
  EXPECT_EQ(run({"--help"}).code, 0);
  EXPECT_NE(run({"--help"}).out.find("Examples:"), std::string::npos);
  const Finished size = run({"--size", "320"});
  EXPECT_EQ(size.code, 2);
  EXPECT_NE(size.err.find("'320' is not WIDTHxHEIGHT"), std::string::npos) << size.err;
  EXPECT_EQ(run({"--frames", "0"}).code, 2);
  ICLK_NEED_DEVICE();
  const Finished device = run({"--device", "no such device"});
  EXPECT_EQ(device.code, 2);
  EXPECT_NE(device.err.find("no such device"), std::string::npos) << device.err;
}

}  // namespace
}  // namespace iclk::test
