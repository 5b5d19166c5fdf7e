#include "apps/iclk/io/images.h"

#include <cmath>
#include <limits>

#include <opencv2/imgcodecs.hpp>

#include <iclk/session/io/output.h>

#include "files.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::expect_error;
using test::Folder;

const bool kPrepared = (prepare_opencv(), true);

cv::Mat ramp(int type, int width = 40, int height = 30) {
  cv::Mat m(height, width, type);
  cv::randu(m, 0, CV_MAT_DEPTH(type) == CV_8U ? 255 : 60000);
  return m;
}

TEST(Images, KeepTypeAndPixels) {
  ASSERT_TRUE(kPrepared);
  const Folder folder;
  for (const int type : {CV_8UC1, CV_8UC3, CV_16UC1, CV_16UC3}) {
    const cv::Mat m = ramp(type);
    cv::imwrite(folder.path("a.png"), m);
    const cv::Mat read = load_image(folder.path("a.png"));
    ASSERT_EQ(read.type(), type);
    EXPECT_EQ(cv::norm(m, read, cv::NORM_INF), 0);
  }
}

TEST(Images, DropAlpha) {
  const Folder folder;
  const cv::Mat m = ramp(CV_8UC4);
  cv::imwrite(folder.path("a.png"), m);
  const cv::Mat read = load_image(folder.path("a.png"));
  ASSERT_EQ(read.type(), CV_8UC3);
  EXPECT_EQ(read.at<cv::Vec3b>(3, 5)[0], m.at<cv::Vec4b>(3, 5)[0]);
}

TEST(Images, FloatColourIsRgb) {
  const Folder folder;
  cv::imwrite(folder.path("a.tiff"), cv::Mat(20, 20, CV_32FC3, cv::Scalar(0.1, 0.2, 0.3)));
  const cv::Mat read = load_image(folder.path("a.tiff"));
  ASSERT_EQ(read.type(), CV_32FC3);
  EXPECT_NEAR(read.at<cv::Vec3f>(0, 0)[0], 0.3f, 0.01);  // OpenCV writes a logarithmic TIFF
  EXPECT_EQ(view(read).format, PixelFormat::rgb32f);
}

TEST(Images, BadFilesAreNamed) {
  const Folder folder;
  cv::imwrite(folder.path("good.png"), ramp(CV_8UC3, 200, 200));
  cv::imwrite(folder.path("good.jpg"), ramp(CV_8UC3, 200, 200));
  cv::imwrite(folder.path("good.tiff"), ramp(CV_16UC1, 200, 200));
  cv::imwrite(folder.path("good.bmp"), ramp(CV_8UC3, 200, 200));
  for (const std::string kind : {"png", "jpg", "tiff", "bmp"}) {
    const std::string bytes = bytes_of(folder.path("good." + kind));
    EXPECT_NO_THROW(load_image(folder.path("good." + kind)));
    for (const size_t part : {bytes.size() / 2, bytes.size() - 14, size_t{20}, size_t{1}}) {
      const std::string cut = folder.write("cut." + kind, bytes.substr(0, part));
      expect_error([&] { load_image(cut); }, ErrorCode::io, {"cut.", kind.c_str()});
    }
  }
  expect_error([&] { load_image(folder.path("missing.png")); }, ErrorCode::io, {"missing.png", "No such file"});
  expect_error([&] { load_image(folder.write("empty.png", "")); }, ErrorCode::io, {"empty.png", "empty"});
  expect_error([&] { load_image(folder.write("text.png", "this is not a picture\n")); }, ErrorCode::io,
               {"text.png", "a format that OpenCV cannot read"});
  expect_error([&] { load_image(folder.path("")); }, ErrorCode::io, {"folder"});
}

TEST(Images, AHeaderOfGiantSidesIsAnError) {
  const Folder folder;
  cv::imwrite(folder.path("a.png"), ramp(CV_8UC1));
  std::string bytes = bytes_of(folder.path("a.png"));
  bytes.replace(16, 8, std::string("\x7f\xff\xff\xff\x7f\xff\xff\xff", 8));
  expect_error([&] { load_image(folder.write("giant.png", bytes)); }, ErrorCode::invalid_argument,
               {"giant.png", "2147483647x2147483647", "67108864", "--set max-pixels"});
}

TEST(Images, FloatWithNanIsAnError) {
  const Folder folder;
  cv::Mat m(20, 20, CV_32FC1, cv::Scalar(0.5));
  m.at<float>(4, 4) = NAN;
  cv::imwrite(folder.path("nan.tiff"), m);
  expect_error([&] { load_image(folder.path("nan.tiff")); }, ErrorCode::invalid_argument, {"nan.tiff", "NaN"});
}

TEST(Depth, SixteenBitIsScaled) {
  const Folder folder;
  cv::Mat m(10, 12, CV_16UC1, cv::Scalar(7500));
  m.at<uint16_t>(2, 3) = 0;
  cv::imwrite(folder.path("d.png"), m);
  const cv::Mat depth = load_depth(folder.path("d.png"), 5000);
  EXPECT_FLOAT_EQ(depth.at<float>(0, 0), 1.5f);
  EXPECT_EQ(depth.at<float>(2, 3), 0);
  for (const double scale : {0.0, -5000.0, double(NAN), double(INFINITY)})
    expect_error([&] { load_depth(folder.path("d.png"), scale); }, ErrorCode::invalid_argument, {"d.png", "--depth-scale"});
}

TEST(Depth, FloatIsMetres) {
  const Folder folder;
  cv::Mat m(10, 12, CV_32FC1, cv::Scalar(2.25));
  m.at<float>(0, 0) = NAN;
  m.at<float>(0, 1) = INFINITY;
  m.at<float>(0, 2) = -INFINITY;
  m.at<float>(0, 3) = -1;
  for (const char* name : {"d.tiff", "d.exr"}) {
    ASSERT_TRUE(cv::imwrite(folder.path(name), m)) << name;
    const cv::Mat depth = load_depth(folder.path(name), 0);
    ASSERT_EQ(depth.type(), CV_32FC1);
    EXPECT_EQ(cv::countNonZero(depth), 10 * 12 - 4) << name;
    EXPECT_FLOAT_EQ(depth.at<float>(5, 5), 2.25f);
    for (int u = 0; u < 4; ++u) EXPECT_EQ(depth.at<float>(0, u), 0);
  }
}

TEST(Depth, WrongKindsAreNamed) {
  const Folder folder;
  cv::imwrite(folder.path("8bit.png"), ramp(CV_8UC1));
  cv::imwrite(folder.path("colour.png"), ramp(CV_16UC3));
  cv::imwrite(folder.path("zero.png"), cv::Mat::zeros(10, 10, CV_16UC1));
  cv::imwrite(folder.path("nan.tiff"), cv::Mat(10, 10, CV_32FC1, cv::Scalar(NAN)));
  expect_error([&] { load_depth(folder.path("8bit.png"), 1000); }, ErrorCode::invalid_argument, {"8bit.png", "8-bit"});
  expect_error([&] { load_depth(folder.path("colour.png"), 1000); }, ErrorCode::invalid_argument, {"colour.png", "3 channels"});
  expect_error([&] { load_depth(folder.path("zero.png"), 1000); }, ErrorCode::invalid_argument, {"zero.png", "has no depth"});
  expect_error([&] { load_depth(folder.path("nan.tiff"), 0); }, ErrorCode::invalid_argument, {"nan.tiff", "has no depth"});
}

TEST(Output, WholeOrNotAtAll) {
  const Folder folder;
  write_file(folder.path("a"), "first");
  write_file(folder.path("a"), "second");
  EXPECT_EQ(bytes_of(folder.path("a")), "second");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path("")), {}), 1) << "a temporary file stays";
  expect_error([&] { write_file(folder.path("no/such/folder/a"), "x"); }, ErrorCode::io, {"no/such/folder/a"});
  expect_error([&] { make_output_folder(folder.path("a/b")); }, ErrorCode::io, {"a/b"});
  expect_error([&] { make_output_folder(folder.path("a")); }, ErrorCode::io, {"a"});
  make_output_folder(folder.path("b/c"));
  make_output_folder(folder.path("b/c"));
  EXPECT_TRUE(std::filesystem::is_directory(folder.path("b/c")));
}

}  // namespace
}  // namespace iclk
