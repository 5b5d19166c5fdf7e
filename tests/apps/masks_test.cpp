// Masks as files: --mask, --reference-mask, --target-mask, and the border of an undistorted image.
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/session/io/distortion.h>
#include <iclk/session/pose_errors.h>

#include "apps/iclk/session/run_pairs.h"
#include "apps/iclk/sets/scene.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;

constexpr int kWidth = 320, kHeight = 240;
const cv::Rect kOccluder(60, 40, 200, 160);

/// A scene in files; in other.png something else has moved in front of the target.
class Masks : public ::testing::Test {
 protected:
  Masks() {
    Vector6d xi;
    xi << 0.02, -0.01, 0.02, 0.01, 0.015, -0.02;
    SceneOptions options;
    options.width = kWidth;
    options.height = kHeight;
    scene_ = make_scene_pair(SE3::exp(xi), options);
    cv::imwrite(folder_.path("a.png"), scene_.image_0);
    cv::imwrite(folder_.path("b.png"), scene_.image_1);
    cv::imwrite(folder_.path("d.tiff"), scene_.depth_0);
    cv::Mat other = scene_.image_1.clone(), moved;
    cv::warpAffine(scene_.image_0, moved, cv::Matx23d(1, 0, 4, 0, 1, -3), other.size());
    moved(kOccluder).copyTo(other(kOccluder));
    cv::imwrite(folder_.path("other.png"), other);
    cv::Mat mask(kHeight, kWidth, CV_8UC1, cv::Scalar(255));
    mask(kOccluder) = 0;
    cv::imwrite(folder_.path("mask.png"), mask);
    cv::imwrite(folder_.path("small.png"), mask(cv::Rect(0, 0, 100, 50)));
  }
  PairInput load(const PairFiles& files, const std::string& mask = "", const std::string& distortion = "") const {
    InputOptions options;
    options.camera.camera = scene_.camera;
    options.mask = mask;
    if (!distortion.empty()) options.distortion = parse_distortion(distortion);
    PairInput pair = PairLoader(options).load(files);
    pair.truth = scene_.T_10;
    return pair;
  }
  PairFiles files(const std::string& target = "other.png") const {
    return {folder_.path("a.png"), folder_.path(target), folder_.path("d.tiff"), ""};
  }
  static RefinedAlignment run(const PairInput& pair) {
    Session session({.solver = Solver::cpu, .stages = {{}}});
    return run_pair(session, pair);
  }
  static double error(const PairInput& pair, const RefinedAlignment& result) {
    return pose_error(pair.camera, pair.features, *pair.truth, result.T_10).e_pixel;
  }
  Folder folder_;
  ScenePair scene_;
};

TEST_F(Masks, OfTheTargetHidesWhatMoved) {
  const PairInput open = load(files());
  EXPECT_TRUE(open.mask_1.empty());
  PairFiles masked_files = files();
  masked_files.target_mask = folder_.path("mask.png");
  const PairInput masked = load(masked_files);
  EXPECT_EQ(cv::countNonZero(masked.mask_1 == 0), kOccluder.area());
  const RefinedAlignment with = run(masked), without = run(open);
  ASSERT_TRUE(with.converged()) << with.reason;
  EXPECT_LT(error(masked, with), 0.1);
  EXPECT_LT(error(masked, with), 0.5 * error(open, without)) << "the scene is too easy to show anything";
  for (const AlignedFeature& f : with.features)
    if (f.status == FeatureStatus::aligned) {
      const cv::Point at(cvRound(f.uv1.x()), cvRound(f.uv1.y()));
      EXPECT_FALSE(kOccluder.contains(at)) << f.uv1.transpose();
    }
}

TEST_F(Masks, OfTheReferenceTakesDepthAndFeatures) {
  PairFiles masked = files("b.png");
  masked.reference_mask = folder_.path("mask.png");
  const PairInput pair = load(masked);
  EXPECT_TRUE(pair.mask_1.empty());
  EXPECT_EQ(cv::countNonZero(pair.depth_0(kOccluder)), 0);
  EXPECT_GT(cv::countNonZero(pair.depth_0), kWidth * kHeight / 3);
  for (const Eigen::Vector2d& uv : pair.features.uv) {
    const cv::Rect patch(static_cast<int>(uv.x()) - 3, static_cast<int>(uv.y()) - 3, 8, 8);
    EXPECT_EQ((patch & kOccluder).area(), 0) << uv.transpose();
  }
  // Those of a file stay where they are in its list.
  masked.features = folder_.write("f.csv", "u,v,depth\n20,20,2\n150,120,2\n57,100,2\n55,100,2\n");
  const std::vector<double> q = load(masked).features.inverse_depth;
  EXPECT_EQ(q, (std::vector<double>{0.5, 0, 0, 0.5})) << "a patch is 8x8, the first pixel 3 before the feature's";
}

TEST_F(Masks, OfBothImages) {
  const PairInput pair = load(files(), folder_.path("mask.png"));
  EXPECT_EQ(cv::countNonZero(pair.mask_1 == 0), kOccluder.area());
  EXPECT_EQ(cv::countNonZero(pair.depth_0(kOccluder)), 0);
  const RefinedAlignment r = run(pair);
  EXPECT_TRUE(r.converged()) << r.reason;
  EXPECT_LT(error(pair, r), 0.1);
}

TEST_F(Masks, AreUndistortedWithTheirImage) {
  const PairInput border = load(files("b.png"), "", "radtan:0.4,0,0,0");
  ASSERT_FALSE(border.mask_1.empty()) << "corners that the lens never saw";
  EXPECT_EQ(border.mask_1.at<uchar>(0, 0), 0);
  EXPECT_EQ(border.mask_1.at<uchar>(kHeight / 2, kWidth / 2), 255);
  PairFiles masked = files("b.png");
  masked.target_mask = folder_.path("mask.png");
  const PairInput both = load(masked, "", "radtan:0.4,0,0,0");
  EXPECT_EQ(both.mask_1.at<uchar>(0, 0), 0);
  EXPECT_EQ(cv::countNonZero(both.mask_1 & ~border.mask_1), 0);
  // x = r (1 + 0.4 r^2) of the distorted image: the occluder's right edge, 259.5 there, moves towards the middle.
  const Camera& c = scene_.camera;
  double r = 0;
  while (r * (1 + 0.4 * r * r) < (259.5 - c.cx) / c.fx) r += 1e-4;
  const int row = cvRound(c.cy), edge = static_cast<int>(c.cx + c.fx * r);
  EXPECT_LT(edge, 258);
  EXPECT_EQ(both.mask_1.at<uchar>(row, edge - 1), 0);
  EXPECT_EQ(both.mask_1.at<uchar>(row, edge + 2), 255);
}

TEST_F(Masks, BadOnesAreNamed) {
  PairFiles wrong = files();
  wrong.target_mask = folder_.path("small.png");
  expect_error([&] { load(wrong); }, ErrorCode::invalid_argument, {"small.png", "100x50", "320x240"});
  wrong.target_mask = folder_.path("none.png");
  expect_error([&] { load(wrong); }, ErrorCode::io, {"none.png"});
  expect_error([&] { load(files(), folder_.path("none.png")); }, ErrorCode::io, {"none.png"});
}

}  // namespace
}  // namespace iclk
