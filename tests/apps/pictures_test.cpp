#include "apps/iclk/pictures/pictures.h"

#include <gtest/gtest.h>

#include <cmath>

#include "apps/iclk/sets/scene.h"

namespace iclk {
namespace {

PairInput scene_input(const SE3& T_10) {
  SceneOptions options;
  options.width = 320;
  options.height = 240;
  options.noise = 0;
  const ScenePair scene = make_scene_pair(T_10, options);
  PairInput pair;
  pair.image_0 = scene.image_0;
  pair.image_1 = scene.image_1;
  pair.depth_0 = scene.depth_0;
  pair.camera = scene.camera;
  pair.truth = scene.T_10;
  detect_missing_features(pair, {});
  return pair;
}

double mean_difference(const cv::Mat& warped, const cv::Mat& grey_0, double gain, double bias) {
  double sum = 0, n = 0;
  for (int v = 0; v < warped.rows; ++v)
    for (int u = 0; u < warped.cols; ++u)
      if (const float x = warped.at<float>(v, u); !std::isnan(x))
        sum += std::abs((x - bias) / gain - grey_0.at<uchar>(v, u)), n += 1;
  EXPECT_GT(n, 0.7 * static_cast<double>(warped.total()));
  return sum / n;
}

TEST(Scene, TruthDepthAndExposureAgree) {
  // Warped by the exact depth and pose, the target must be the reference but for exposure and interpolation: this ties the
  // scene's frames, its depth and the warp's direction together.
  const PairInput pair = scene_input(demo_motion());
  const cv::Mat grey_0 = grey_8bit(pair.image_0), grey_1 = grey_8bit(pair.image_1);
  const SceneOptions defaults;
  const double right =
      mean_difference(warp_target(grey_1, pair.depth_0, pair.camera, *pair.truth), grey_0, defaults.gain, defaults.bias);
  const double start =
      mean_difference(warp_target(grey_1, pair.depth_0, pair.camera, SE3()), grey_0, defaults.gain, defaults.bias);
  const double inverted = mean_difference(warp_target(grey_1, pair.depth_0, pair.camera, pair.truth->inverse()), grey_0,
                                          defaults.gain, defaults.bias);
  EXPECT_LT(right, 4);
  EXPECT_GT(start, 5 * right);
  EXPECT_GT(inverted, 5 * right);
}

TEST(Pictures, SparseDepthIsInterpolatedWithinTheHull) {
  PairInput pair = scene_input(SE3());
  const cv::Mat exact = pair.depth_0;
  pair.depth_0 = cv::Mat();
  const cv::Mat depth = picture_depth(pair);
  double worst = 0;
  for (const Eigen::Vector2d& uv : pair.features.uv) {
    const int u = static_cast<int>(uv.x()), v = static_cast<int>(uv.y());
    ASSERT_GT(depth.at<float>(v, u), 0);
    worst = std::max(worst, std::abs(static_cast<double>(depth.at<float>(v, u)) - exact.at<float>(v, u)));
  }
  EXPECT_LT(worst, 0.05) << "2 m away, relief 0.3 m";
  EXPECT_EQ(depth.at<float>(0, 0), 0) << "outside the hull";
}

TEST(Pictures, EveryKindOfResultIsDrawn) {
  PairInput pair = scene_input(demo_motion());
  pair.features.uv.push_back({NAN, 1});
  pair.features.inverse_depth.push_back(1);
  pair.features.uv.push_back({1e30, -1e30});
  pair.features.inverse_depth.push_back(1e-30);
  RefinedAlignment result;
  result.T_10 = *pair.truth;
  for (const bool truth : {true, false}) {
    for (const bool depth : {true, false}) {
      PairInput p = pair;
      if (!truth) p.truth.reset();
      if (!depth) p.depth_0 = cv::Mat();
      const std::vector<Picture> pictures = make_pictures(p, result);
      ASSERT_EQ(pictures.size(), 3u);
      for (const Picture& picture : pictures) EXPECT_EQ(picture.image.type(), CV_8UC3) << picture.file;
    }
  }
  result.T_10.t = {0, 0, -1e6};  // everything lies behind the camera
  EXPECT_EQ(make_pictures(pair, result).size(), 3u);
}

}  // namespace
}  // namespace iclk
