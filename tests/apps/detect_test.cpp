#include <iclk/session/detect.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <future>

#include <opencv2/imgproc.hpp>

#include <iclk/session/internal/corners.h>
#include <iclk/session/internal/grey.h>

#include "apps/iclk/io/images.h"
#include "files.h"

namespace iclk {
namespace {

cv::Mat noise_image(int width, int height) {
  cv::Mat m(height, width, CV_8UC1);
  cv::RNG random(7);
  random.fill(m, cv::RNG::UNIFORM, 0, 255);
  return m;
}

Features detect_features(const cv::Mat& image, const cv::Mat& depth, const cv::Mat& seen, const DetectorOptions& options) {
  return iclk::detect_features(view(image), view(depth), view(seen), options);
}

const Detector kAll[] = {Detector::shi_tomasi, Detector::grid, Detector::random};

DetectorOptions options_of(Detector detector, int count = 50, uint64_t seed = 0) { return {detector, count, seed, 17}; }

TEST(Detect, FeaturesAreValidSpreadAndCounted) {
  const cv::Mat image = noise_image(320, 240), depth(240, 320, CV_32FC1, cv::Scalar(2));
  for (const Detector detector : kAll) {
    const Features f = detect_features(image, depth, {}, options_of(detector));
    ASSERT_EQ(f.size(), 50);
    int quadrants[4] = {};
    for (int i = 0; i < f.size(); ++i) {
      const Eigen::Vector2d uv = f.uv[static_cast<size_t>(i)];
      EXPECT_EQ(uv, uv.array().round().matrix());
      EXPECT_GE(uv.x(), 17);
      EXPECT_GE(uv.y(), 17);
      EXPECT_LT(uv.x(), 320 - 17);
      EXPECT_LT(uv.y(), 240 - 17);
      EXPECT_DOUBLE_EQ(f.inverse_depth[static_cast<size_t>(i)], 0.5);
      ++quadrants[(uv.x() > 160) + 2 * (uv.y() > 120)];
    }
    for (const int n : quadrants) EXPECT_GE(n, 5) << "bunched";
  }
}

TEST(Detect, SameInputSameFeatures) {
  const cv::Mat image = noise_image(320, 240), depth(240, 320, CV_32FC1, cv::Scalar(2));
  for (const Detector detector : kAll) {
    const Features a = detect_features(image, depth, {}, options_of(detector, 30, 5)),
                   b = detect_features(image, depth, {}, options_of(detector, 30, 5));
    EXPECT_EQ(a.uv, b.uv);
  }
  EXPECT_NE(detect_features(image, depth, {}, options_of(Detector::random, 30, 1)).uv,
            detect_features(image, depth, {}, options_of(Detector::random, 30, 2)).uv);
}

TEST(Detect, OnlyWhereThereIsDepthAndItWasSeen) {
  const cv::Mat image = noise_image(320, 240);
  cv::Mat depth = cv::Mat::zeros(240, 320, CV_32FC1), seen(240, 320, CV_8UC1, cv::Scalar(255));
  depth(cv::Rect(0, 0, 160, 240)).setTo(3);
  seen(cv::Rect(0, 0, 320, 100)).setTo(0);
  for (const Detector detector : kAll) {
    const Features f = detect_features(image, depth, seen, options_of(detector, 200));
    EXPECT_GT(f.size(), 10);
    for (const Eigen::Vector2d& uv : f.uv) {
      EXPECT_LT(uv.x(), 160);
      EXPECT_GE(uv.y(), 103) << "the whole patch must have been seen";
    }
  }
}

TEST(Detect, SmoothDepthComesBeforeDepthEdges) {
  const cv::Mat image = noise_image(320, 240);
  cv::Mat depth(240, 320, CV_32FC1, cv::Scalar(1));
  depth(cv::Rect(160, 0, 160, 240)).setTo(2);  // an edge between columns 159 and 160
  for (const Detector detector : kAll)
    for (const Eigen::Vector2d& uv : detect_features(image, depth, {}, options_of(detector)).uv)
      EXPECT_TRUE(uv.x() < 156 || uv.x() >= 163) << uv.transpose();
  // Where nothing is smooth, edges serve.
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 320; ++u) depth.at<float>(v, u) = (u / 3 + v / 3) % 2 ? 1.0f : 2.0f;
  for (const Detector detector : kAll) EXPECT_EQ(detect_features(image, depth, {}, options_of(detector)).size(), 50);
}

TEST(Detect, CornersAreFound) {
  cv::Mat image(240, 320, CV_8UC1, cv::Scalar(100));
  image(cv::Rect(100, 80, 60, 50)).setTo(200);
  const Features f =
      detect_features(image, cv::Mat(240, 320, CV_32FC1, cv::Scalar(2)), {}, options_of(Detector::shi_tomasi, 4));
  ASSERT_EQ(f.size(), 4);
  for (const Eigen::Vector2d& uv : f.uv) {
    const double du = std::min(std::abs(uv.x() - 99.5), std::abs(uv.x() - 159.5)),
                 dv = std::min(std::abs(uv.y() - 79.5), std::abs(uv.y() - 129.5));
    EXPECT_LT(std::max(du, dv), 5) << uv.transpose();
  }
}

TEST(Detect, EveryPartGivesItsBestCornersButNoneTooWeakToAlign) {
  const cv::Mat depth(240, 320, CV_32FC1, cv::Scalar(2)), noise = noise_image(320, 240);
  const auto right_of = [&](double contrast) {  // features in the right half, whose contrast is a share of the left one's
    cv::Mat image = noise.clone(), right = image(cv::Rect(160, 0, 160, 240));
    right.convertTo(right, CV_8U, contrast, 127);
    const Features f = detect_features(image, depth, {}, options_of(Detector::shi_tomasi, 100));
    return std::count_if(f.uv.begin(), f.uv.end(), [](const Eigen::Vector2d& uv) { return uv.x() >= 164; });
  };
  EXPECT_GT(right_of(0.05), 35) << "weak corners have their share";
  EXPECT_EQ(right_of(0.004), 0) << "one grey level is no texture for feature alignment";
}

TEST(Detect, NothingToFindIsNotAnError) {
  const cv::Mat flat(240, 320, CV_8UC1, cv::Scalar(100)), none = cv::Mat::zeros(240, 320, CV_32FC1);
  for (const Detector detector : kAll) {
    EXPECT_EQ(detect_features(flat, none, {}, options_of(detector)).size(), 0);
  }
}

TEST(Detect, WithoutTextureThereIsAGridForTheAlignerToJudge) {
  const cv::Mat flat(240, 320, CV_8UC1, cv::Scalar(100)), depth(240, 320, CV_32FC1, cv::Scalar(1));
  const Features grid = detect_features(flat, depth, {}, options_of(Detector::grid)),
                 corners = detect_features(flat, depth, {}, options_of(Detector::shi_tomasi));
  EXPECT_EQ(grid.size(), 50);
  EXPECT_EQ(corners.uv, grid.uv);
}

TEST(Detect, SmallImagesKeepAQuarterFreeAndStandCloser) {
  for (const Detector detector : kAll) {
    const Features f = detect_features(noise_image(16, 16), cv::Mat(16, 16, CV_32FC1, cv::Scalar(1)), {}, options_of(detector));
    EXPECT_GE(f.size(), 6);
    for (const Eigen::Vector2d& uv : f.uv) {
      EXPECT_GE(uv.minCoeff(), 4);
      EXPECT_LT(uv.maxCoeff(), 12);
    }
  }
}

TEST(Detect, TenThousand) {
  const cv::Mat image = noise_image(1600, 1200), depth(1200, 1600, CV_32FC1, cv::Scalar(2));
  EXPECT_EQ(detect_features(image, depth, {}, options_of(Detector::shi_tomasi, 10000)).size(), 10000);
}

TEST(Detect, BadOptions) {
  const cv::Mat image = noise_image(64, 64), depth(64, 64, CV_32FC1, cv::Scalar(2));
  test::expect_error([&] { detect_features(image, depth, {}, options_of(Detector::grid, 0)); }, ErrorCode::invalid_argument,
                     {"count 0"});
  test::expect_error([&] { detect_features(image, depth(cv::Rect(0, 0, 32, 64)), {}, options_of(Detector::grid)); },
                     ErrorCode::invalid_argument, {"32x64", "64x64"});
  test::expect_error([&] { detect_features(image, depth, depth, options_of(Detector::grid)); }, ErrorCode::invalid_argument,
                     {"mask", "r8"});
  test::expect_error([] { parse_detector("sift"); }, ErrorCode::invalid_argument, {"sift", "shi-tomasi"});
}

TEST(Detect, CornersStandApart) {
  for (const auto& [width, distance] : {std::pair(320, 7), std::pair(40, 2)}) {  // beyond a disc of that radius
    const int height = width * 3 / 4;
    const Features f = detect_features(noise_image(width, height), cv::Mat(height, width, CV_32FC1, cv::Scalar(2)), {},
                                       options_of(Detector::shi_tomasi, 5000));
    EXPECT_GT(f.size(), width == 320 ? 300 : 5);
    for (size_t i = 0; i < f.uv.size(); ++i)
      for (size_t j = 0; j < i; ++j) ASSERT_GT((f.uv[i] - f.uv[j]).norm(), distance) << width;
  }
}

TEST(Detect, DepthThatIsNoneCarriesNoFeature) {
  cv::Mat depth(240, 320, CV_32FC1, cv::Scalar(2));
  const float none[] = {0, -1, NAN, INFINITY};
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 160; ++u) depth.at<float>(v, u) = none[(u + v) % 4];
  for (const Detector detector : kAll) {
    const Features f = detect_features(noise_image(320, 240), depth, {}, options_of(detector, 40));
    EXPECT_GE(f.size(), 15);
    for (const Eigen::Vector2d& uv : f.uv) EXPECT_GE(uv.x(), 160);
    for (const double q : f.inverse_depth) EXPECT_EQ(q, 0.5);
  }
}

TEST(Detect, ThreadsDisturbNobody) {
  const cv::Mat image = noise_image(320, 240), depth(240, 320, CV_32FC1, cv::Scalar(2));
  const auto once = [&] { return detect_features(image, depth, {}, options_of(Detector::shi_tomasi, 200)).uv; };
  const auto expected = once();
  std::vector<std::future<std::vector<Eigen::Vector2d>>> found;
  for (int i = 0; i < 8; ++i) found.push_back(std::async(std::launch::async, once));
  for (auto& f : found) EXPECT_EQ(f.get(), expected);
}

TEST(Corners, AreThoseOfOpenCv) {
  cv::RNG random(5);
  for (int i = 0; i < 60; ++i) {
    cv::Mat image(random.uniform(1, 60), random.uniform(1, 60), CV_8UC1), expected;
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    if (i % 2) cv::GaussianBlur(image, image, {}, 2);
    cv::cornerMinEigenVal(image, expected, 7, 3);
    const std::vector<uint8_t> grey(image.datastart, image.dataend);
    const std::vector<float> found = corner_response(grey, image.cols, image.rows);
    ASSERT_EQ(found.size(), expected.total());
    // To the bit where OpenCV has an instruction for a * b + c, and rounds once.
    for (size_t j = 0; j < found.size(); ++j) ASSERT_NEAR(found[j], expected.ptr<float>()[j], 1e-6) << image.size() << " " << j;
  }
}

TEST(Corners, HaveTheSameBitsOnAllMachines) {
  std::vector<uint8_t> grey(97 * 61);
  uint32_t state = 1;
  for (uint8_t& p : grey) p = static_cast<uint8_t>((state = state * 1664525 + 1013904223) >> 24);
  uint32_t hash = 2166136261;  // FNV-1a
  for (const float x : corner_response(grey, 97, 61)) hash = (hash ^ std::bit_cast<uint32_t>(x)) * 16777619;
  EXPECT_EQ(hash, 3876797848u);
}

TEST(Grey, IsLuma) {
  cv::RNG random(5);
  for (const int type : {CV_8UC1, CV_8UC3, CV_16UC1, CV_16UC3, CV_32FC1, CV_32FC3}) {
    cv::Mat image(40, 50, type), luma, expected;
    random.fill(image, cv::RNG::UNIFORM, 10, CV_MAT_DEPTH(type) == CV_16U ? 30000 : 250);
    luma = image;
    if (image.channels() == 3) cv::cvtColor(image, luma, type == CV_32FC3 ? cv::COLOR_RGB2GRAY : cv::COLOR_BGR2GRAY);
    expected = luma;
    if (luma.depth() != CV_8U) cv::normalize(luma, expected, 0, 255, cv::NORM_MINMAX, CV_8U);
    const std::vector<uint8_t> grey = grey_8bit(view(image));
    EXPECT_LE(cv::norm(cv::Mat(grey).reshape(1, 40), expected, cv::NORM_INF), luma.depth() == CV_8U ? 0 : 1) << type;
  }
  const std::array<uint32_t, 2> rgba = {0xFF0000FF, 0xFFFF0000};  // red, blue
  EXPECT_EQ(grey_8bit({rgba.data(), 2, 1, 0, PixelFormat::rgba8}), (std::vector<uint8_t>{76, 29}));
}

TEST(Grey, OfDeepImagesFillsTheRange) {
  cv::Mat deep(2, 2, CV_16UC1, cv::Scalar(1000));
  deep.at<uint16_t>(1, 1) = 3000;
  const cv::Mat grey = grey_8bit(deep);
  EXPECT_EQ(grey.at<uchar>(0, 0), 0);
  EXPECT_EQ(grey.at<uchar>(1, 1), 255);
}

}  // namespace
}  // namespace iclk
