// Starts by matching against OpenCV: descriptors of 16 numbers find what the correlation of all 64 pixels finds.
#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include <iclk/align/search/matching.h>

#include "relief.h"

namespace iclk::test {
namespace {

cv::Mat mat(const Map& map) { return cv::Mat(map.height, map.width, CV_32FC1, const_cast<float*>(map.data.data())); }

std::array<float, ICLK_PATCH_AREA> patch_at(const Map& map, int u, int v) {
  std::array<float, ICLK_PATCH_AREA> patch;
  for (int k = 0; k < ICLK_PATCH_AREA; ++k) patch[static_cast<size_t>(k)] = map.at(u + k % ICLK_PATCH, v + k / ICLK_PATCH);
  return patch;
}

double similarity(const internal::MatchDescriptor& a, const internal::MatchDescriptor& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

struct Best {
  cv::Point place;
  double score, elsewhere;
};

Best best_of(const cv::Mat& scores) {
  Best best;
  cv::minMaxLoc(scores, nullptr, &best.score, nullptr, &best.place);
  cv::Mat others = scores.clone();
  cv::rectangle(others, best.place - cv::Point(6, 6), best.place + cv::Point(6, 6), -2, cv::FILLED);
  cv::minMaxLoc(others, nullptr, &best.elsewhere);
  return best;
}

TEST(MatchTemplate, FindsTheSamePlaces) {
  int distinct = 0, same = 0;
  double agreement = 0;
  int patches = 0;
  for (uint32_t seed = 1; seed <= 3; ++seed) {
    Relief scene;
    scene.camera = {300, 300, 159.5, 119.5, 320, 240};
    scene.depth_amplitude = 0.3;
    scene.seed = seed;
    scene.shortest = 8;
    scene.noise = 0.005;
    scene.gain = 0.7, scene.bias = 0.1;
    scene.T_10.t = {0.5, -0.2, 0.2};
    Plan plan{320, 240};
    plan.max_features = 100;
    AlignerOptions options;
    options.search = true;
    const internal::MatchLayout layout(plan, options);
    ASSERT_EQ(layout.scale, 2);
    const Map map0 = internal::match_map(grey_map(render(scene, 0).view()), layout),
              map1 = internal::match_map(grey_map(render(scene, 1).view()), layout);
    // Features in the middle of eight whole pixels of the map, so that both look at the same values.
    Features features;
    std::mt19937 random(seed);
    std::vector<cv::Point> corners;
    for (int i = 0; i < 100; ++i) {
      corners.emplace_back(random() % (160 - 8), random() % (120 - 8));
      features.uv.push_back({2.0 * (corners.back().x + 4) - 0.5, 2.0 * (corners.back().y + 4) - 0.5});
      features.inverse_depth.push_back(1 / scene.depth(features.uv.back()));
    }
    std::vector<internal::MatchDescriptor> places;
    for (int v = 0; v < layout.places_y; ++v)
      for (int u = 0; u < layout.places_x; ++u) places.push_back(internal::describe(patch_at(map1, u, v)));
    const auto checks = check_features(features, scene.camera);
    for (size_t i = 0; i < corners.size(); ++i) {
      const auto patch = patch_at(map0, corners[i].x, corners[i].y);
      cv::Mat expected;
      cv::matchTemplate(mat(map1), mat(map0)(cv::Rect(corners[i].x, corners[i].y, 8, 8)), expected, cv::TM_CCOEFF_NORMED);
      cv::Mat scores(expected.size(), CV_32FC1);
      const auto mine = internal::describe(patch);
      for (int v = 0; v < scores.rows; ++v)
        for (int u = 0; u < scores.cols; ++u)
          scores.at<float>(v, u) = static_cast<float>(similarity(mine, places[static_cast<size_t>(v * scores.cols + u)]));
      cv::Mat related;
      cv::matchTemplate(scores, expected, related, cv::TM_CCOEFF_NORMED);
      agreement += related.at<float>(0, 0);
      ++patches;
      // And as the aligner does it, with rolls, tiles and sub-pixel peaks.
      Features one;
      one.uv = {features.uv[i]};
      one.inverse_depth = {features.inverse_depth[i]};
      const auto found = internal::correspondences(map0, map1, one, std::span(checks).subspan(i, 1), scene.camera, 1, layout,
                                                   internal::Rolls::all);
      const Best best = best_of(expected);
      if (checks[i] != FeatureCheck::ok || best.score < 0.9 || best.score - best.elsewhere < 0.05) continue;
      ++distinct;
      ASSERT_EQ(found.size(), 1u);
      const Eigen::Vector2d place = (found[0].pixel.array() + 0.5) / 2 - 4;
      same += (place - Eigen::Vector2d(best.place.x, best.place.y)).lpNorm<Eigen::Infinity>() <= 1;
    }
  }
  EXPECT_GE(distinct, 60);
  EXPECT_GE(same, 0.95 * distinct);
  EXPECT_GE(agreement / patches, 0.9);
}

}  // namespace
}  // namespace iclk::test
