// What files of other programs say is used or refused.
#include <filesystem>

#include <opencv2/imgcodecs.hpp>

#include <iclk/session/depth_values.h>
#include <iclk/session/io/camera_file.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/io/euroc.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/time_unit.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;

/// A camera_info as `rostopic echo` prints it.
std::string camera_info(const std::string& end, const std::string& d = "[]", const std::string& model = "plumb_bob") {
  return "height: 480\nwidth: 640\ndistortion_model: \"" + model + "\"\nD: " + d +
         "\nK: [600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0]\n" + end;
}

TEST(RosCamera, SizeRegionAndBinningAreUsed) {
  const Folder folder;
  const auto load = [&](const std::string& text) { return load_camera(folder.write("info.yaml", text)); };
  EXPECT_DOUBLE_EQ(fit_camera(load(camera_info("binning_x: 0\nbinning_y: 0\n")), 320, 240).cx, 159.5);
  const Camera binned = fit_camera(load(camera_info("binning_x: 2\nbinning_y: 1\n")), 320, 480);
  EXPECT_DOUBLE_EQ(binned.fx, 300);
  EXPECT_DOUBLE_EQ(binned.fy, 600);
  const std::string roi = "roi:\n  x_offset: 40\n  y_offset: 30\n  height: 240\n  width: 320\n";
  const CameraFile part = load(camera_info(roi));
  EXPECT_DOUBLE_EQ(fit_camera(part, 320, 240).cx, 279.5);
  EXPECT_DOUBLE_EQ(fit_camera(part, 320, 240).cy, 209.5);
  expect_error([&] { fit_camera(part, 640, 480); }, ErrorCode::invalid_argument, {"region of interest", "640x480"});
  EXPECT_DOUBLE_EQ(fit_camera(load(camera_info(roi + "binning_x: 2\nbinning_y: 2\n")), 160, 120).cx, 139.5);
  expect_error([&] { load(camera_info("roi:\n  x_offset: 400\n  width: 320\n  height: 240\n")); }, ErrorCode::invalid_argument,
               {"region of interest", "beyond"});
  expect_error([&] { load(camera_info("binning_x: -1\n")); }, ErrorCode::invalid_argument, {"binning_x"});
}

TEST(RosCamera, Distortion) {
  const Folder folder;
  const auto lens = [&](const std::string& d, const std::string& model) {
    return load_camera(folder.write("info.yaml", camera_info("", d, model))).distortion;
  };
  EXPECT_TRUE(lens("[]", "plumb_bob").empty());
  EXPECT_TRUE(lens("[]", "").empty());
  EXPECT_TRUE(lens("\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n- 0.0", "plumb_bob").empty());
  EXPECT_EQ(lens("[0.1, 0, 0, 0, 0, 0.2, 0, 0]", "rational_polynomial").k, std::vector<double>({0.1, 0, 0, 0, 0, 0.2, 0, 0}));
  EXPECT_EQ(lens("[0.1, 0.2, 0.3, 0.4, 0.0]", "equidistant").k.size(), 4u);
  expect_error([&] { lens("[]", "equidistant"); }, ErrorCode::invalid_argument, {"equidistant", "not 0"});
  expect_error([&] { lens("[0.1, 0.2, 0.3, 0.4]", ""); }, ErrorCode::invalid_argument, {"without a model", "cv::fisheye"});
  expect_error([&] { lens("[0, 0, 0, 0, 0, 0, 0, 0, 0.1, 0, 0, 0]", "plumb_bob"); }, ErrorCode::invalid_argument, {"not 9"});
  const std::string turned = "image_width: 640\nimage_height: 480\ncamera_matrix: [600, 0, 0, 0, 600, 0, 319.5, 239.5, 1]\n";
  expect_error([&] { load_camera(folder.write("t.yaml", turned)); }, ErrorCode::invalid_argument,
               {"camera_matrix", "row by row"});
  const CameraFile ros2 = load_camera(
      folder.write("ros2.yaml",
                   "\xef\xbb\xbfheight: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- 0.1\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n"
                   "k:\n- 600.0\n- 0.0\n- 319.5\n- 0.0\n- 600.0\n- 239.5\n- 0.0\n- 0.0\n- 1.0\n---\n"));
  EXPECT_EQ(ros2.camera.width, 640);
  EXPECT_EQ(ros2.distortion.k[0], 0.1);
}

TEST(ForeignCamera, ColmapIsRead) {
  const Folder folder;
  const auto load = [&](const std::string& line) { return load_camera(folder.write("cameras.txt", "# one\n" + line + "\n")); };
  const CameraFile a = load("1 PINHOLE 640 480 500 510 320 240");
  EXPECT_EQ(a.camera.fy, 510);
  EXPECT_EQ(a.camera.cx, 319.5) << "COLMAP's first pixel has its centre at 0.5";
  EXPECT_TRUE(a.distortion.empty());
  EXPECT_EQ(load("1 SIMPLE_RADIAL 640 480 500 320 240 -0.1").distortion.k, std::vector<double>({-0.1, 0, 0, 0}));
  EXPECT_EQ(load("7 OPENCV 640 480 500 510 320 240 0.1 0.2 0.3 0.4").distortion.k[3], 0.4);
  EXPECT_EQ(load("1 OPENCV_FISHEYE 640 480 500 510 320 240 0.1 0.2 0.3 0.4").distortion.model, Distortion::Model::equidistant);
  EXPECT_EQ(load("1 PINHOLE 640 480 500 510 320 240\n2 PINHOLE 640 480 500 510 320 240").camera.fx, 500);
  expect_error([&] { load("1 PINHOLE 640 480 500 510 320 240\n2 PINHOLE 640 480 400 510 320 240"); },
               ErrorCode::invalid_argument, {"cameras.txt", "several cameras"});
  expect_error([&] { load("1 FOV 640 480 500 510 320 240 0.9"); }, ErrorCode::invalid_argument, {"FOV", "SIMPLE_RADIAL"});
  expect_error([&] { load("1 PINHOLE 640 480 500 320 240"); }, ErrorCode::invalid_argument, {"PINHOLE", "4 parameters, not 3"});
}

TEST(ForeignCamera, OthersAreNamed) {
  const Folder folder;
  const std::pair<const char*, const char*> files[] = {{"%YAML:1.0\nCamera.fx: 500\n", "ORB-SLAM"},
                                                       {"Pinhole 0.5 0.6 0.5 0.5 0\n640 480\n", "DSO"},
                                                       {"{\n \"fl_x\": 500.0\n}\n", "nerfstudio"},
                                                       {"P0: 7.1e2 0 6.0e2 0 0 7.1e2 1.8e2 0 0 0 1 0\n", "KITTI"},
                                                       {"cam0=[500 0 320; 0 500 240; 0 0 1]\n", "Middlebury"},
                                                       {"<?xml version=\"1.0\"?>\n<opencv_storage>\n", "XML"},
                                                       {"\xff\xfe"
                                                        "5",
                                                        "UTF-16"}};
  for (const auto& [text, name] : files)
    expect_error([&] { load_camera(folder.write("c.txt", text)); }, ErrorCode::invalid_argument, {"c.txt", name, "COLMAP"});
  EXPECT_EQ(load_camera(folder.write("c.txt", "# Pinhole fx fy cx cy\n500 500 320 240\n")).camera.fx, 500);
}

TEST(Intrinsics, OverTheImagesSidesAreRefused) {
  expect_error([] { fit_camera(load_camera("0.9375,1.25,0.4984,0.4979"), 320, 240); }, ErrorCode::invalid_argument,
               {"0.9375", "320x240", "by the width"});
  EXPECT_NO_THROW(fit_camera(load_camera("64,64,159.5,119.5"), 320, 240));
}

TEST(DepthValues, OneValueOfManyPixelsIsNoMeasurement) {
  for (const float none : {65.535f, 65504.0f, 1e10f, 3.4028235e38f, 1000.0f, 10.0f}) {
    std::vector<float> z(1000);
    for (size_t i = 0; i < z.size(); ++i) z[i] = i % 4 == 0 ? none : 2 + 1e-3f * static_cast<float>(i);
    EXPECT_EQ(keep_measured(z), 750u) << none;
    EXPECT_EQ(z[0], 0);
    EXPECT_FLOAT_EQ(z[1], 2.001f);
  }
  std::vector<float> flat(1000, 2.0f), steps(1000);
  EXPECT_EQ(keep_measured(flat), 1000u) << "a plane before the camera";
  for (size_t i = 0; i < steps.size(); ++i) steps[i] = 1 + static_cast<float>(i / 100);
  EXPECT_EQ(keep_measured(steps), 1000u) << "coarse steps";
}

TEST(DepthFiles, WhatTheySayIsUsedOrRefused) {
  const Folder folder;
  cv::Mat deep(40, 40, CV_16UC1);
  for (int i = 0; i < 1600; ++i) deep.at<uint16_t>(i) = static_cast<uint16_t>(i == 7 ? 65535 : 2000 + i);
  cv::imwrite(folder.path("d.png"), deep);
  EXPECT_EQ(load_depth(folder.path("d.png"), 1000).at<float>(7), 0) << "saturated";
  cv::imwrite(folder.path("mm.tiff"), cv::Mat(10, 10, CV_32FC1, cv::Scalar(2500)));
  expect_error([&] { load_depth(folder.path("mm.tiff"), 1000); }, ErrorCode::invalid_argument,
               {"mm.tiff", "float", "1000 units", "--depth-scale 1"});
  EXPECT_EQ(load_depth(folder.path("mm.tiff"), 1).at<float>(0), 2500);
  const std::string pixel("\0\0\x80\x3f", 4);
  folder.write("scaled.pfm", "Pf\n1 1\n-0.5\n" + pixel);
  expect_error([&] { load_depth(folder.path("scaled.pfm"), 0); }, ErrorCode::invalid_argument, {"scaled.pfm", "scale 0.5"});
  EXPECT_EQ(load_depth(folder.write("one.pfm", "Pf\n1 1\n-1\n" + pixel), 0).at<float>(0), 1);
  cv::imwrite(folder.path("z.exr"), cv::Mat(10, 10, CV_32FC1, cv::Scalar(2.5)));
  std::string exr = test::bytes_of(folder.path("z.exr"));
  const size_t at = exr.find(std::string("Y\0", 2), exr.find("chlist"));
  ASSERT_NE(at, std::string::npos);
  exr[at] = 'Z';
  expect_error([&] { load_depth(folder.write("z.exr", exr), 0); }, ErrorCode::invalid_argument, {"z.exr", "channels Z"});
}

TEST(Levels, OfFewBitsFillTheRange) {
  cv::Mat thermal(40, 50, CV_16UC1), other = cv::Mat(40, 50, CV_16UC1, cv::Scalar(8500)), full(40, 50, CV_16UC1);
  for (int i = 0; i < 2000; ++i)
    thermal.at<uint16_t>(i) = static_cast<uint16_t>(8000 + i), full.at<uint16_t>(i) = 30 * i & 0xffff;
  const cv::Mat before = full.clone();
  const Levels levels{thermal, other};
  levels.apply(thermal);
  levels.apply(other);
  double low = 0, high = 0;
  cv::minMaxLoc(thermal, &low, &high);
  EXPECT_NEAR(high - low, 65535 / 1.5, 300);
  EXPECT_EQ(other.at<uint16_t>(0), thermal.at<uint16_t>(500)) << "one level for both";
  Levels{full}.apply(full);
  EXPECT_EQ(cv::norm(full, before, cv::NORM_INF), 0);
}

TEST(Times, UnitsOfListsAndNames) {
  EXPECT_EQ(time_unit({1403636579.76, 1403636579.81}), 1);
  EXPECT_EQ(time_unit({1403636579763, 1403636579813}), 1e-3);
  EXPECT_EQ(time_unit({1403636579763.5, 1403636579813.5}), 1e-3);
  EXPECT_EQ(time_unit({1403636579763555, 1403636579763556}), 1e-6);
  EXPECT_EQ(time_unit({1403636579763555584.0, 1403636579813555584.0}), 1e-9);
  EXPECT_EQ(time_unit({132e15, 132e15 + 333333}), 1e-7);
  EXPECT_EQ(time_unit({0, 33, 67, 100}), 1e-3);
  EXPECT_EQ(time_unit({0, 33333, 66667}), 1e-6);
  EXPECT_EQ(time_unit({1.2e12, 1.2e12 + 33333333, 1.2e12 + 66666666}), 1e-9) << "since the machine began";
  EXPECT_EQ(time_unit({1, 2, 3}), 1);
  EXPECT_EQ(time_unit({0, 5, 10}, 1e-3), 1e-3);
  EXPECT_EQ(time_unit({0.5, 5.5, 10.5}, 1e-3), 1);
}

TEST(Times, SequencesAreInSeconds) {
  const Folder folder;
  folder.write("rgb.txt", "\xef\xbb\xbf# ns\n1403636579763555584 a.png\n1403636579813555584 b.png\n");
  folder.write("depth.txt", "1403636579767555584 a.png\n");
  folder.write("groundtruth.txt", "1403636579.76 0 0 0 0 0 0 1\n1403636579.82 1 0 0 0 0 0 1\n");
  const Sequence s = load_sequence(folder.path(""));
  EXPECT_NEAR(s.frames[0].stamp, 1403636579.763555, 1e-5);
  EXPECT_FALSE(s.frames[0].depth.empty());
  EXPECT_TRUE(s.frames[1].T_wc);
  for (const char* name : {"rgb/20240305123045.png", "rgb/20240305123046.png", "depth/20240305123045.png"})
    folder.write(std::string("dates/") + name, "x");
  EXPECT_DOUBLE_EQ(load_sequence(folder.path("dates"), {.rate = 10}).frames[1].stamp, 0.1) << "a date is no time in seconds";
}

TEST(Times, StereoStampsMayDifferByNanoseconds) {
  const Folder folder;
  const std::string sensor =
      "T_BS:\n  data: [1, 0, 0, X, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nresolution: [64, 48]\nintrinsics: [50, 50, 31, 23]\n";
  for (int i = 0; i < 2; ++i) {
    std::string text = sensor;
    text.replace(text.find('X'), 1, i ? "0.1" : "0");
    const std::string camera = "cam" + std::to_string(i) + "/";
    folder.write(camera + "sensor.yaml", text);
    folder.write(camera + "data.csv", i ? "1403636579763555591,r.png\n1403636579863555591,s.png\n"
                                        : "1403636579763555584,a.png\n1403636579813555584,b.png\n");
  }
  const Sequence s = load_euroc_sequence(folder.path(""));
  ASSERT_EQ(s.frames.size(), 1u);
  EXPECT_EQ(s.frames[0].right, folder.path("cam1/data/r.png"));
}

TEST(FeatureFile, InfiniteSigmasAreRefused) {
  expect_error([] { parse_features("u,v,depth,sigma\n1,2,3,inf\n", "f.csv"); }, ErrorCode::invalid_argument,
               {"f.csv:2", "finite"});
  Features features{{{40, 40}}, {0.5}, {-0.1}};
  expect_error(
      [&] {
        check_features(features, {100, 100, 40, 40, 80, 80});
      },
      ErrorCode::invalid_argument, {"feature 0", "-0.1"});
  features.inverse_depth_sigma = {0};
  EXPECT_NO_THROW(check_features(features, {100, 100, 40, 40, 80, 80}));
}

TEST(Output, ALinkBesideIsNotFollowed) {
  const Folder folder;
  folder.write("victim", "mine");
  std::filesystem::create_symlink(folder.path("victim"), folder.path("a.part" + std::to_string(getpid())));
  write_file(folder.path("a"), "x");
  EXPECT_EQ(test::bytes_of(folder.path("victim")), "mine");
  EXPECT_EQ(test::bytes_of(folder.path("a")), "x");
}

}  // namespace
}  // namespace iclk
