#include <cmath>

#include <opencv2/core.hpp>
#include <opencv2/core/persistence.hpp>

#include <iclk/align/se3.h>
#include <iclk/session/io/camera_file.h>
#include <iclk/session/io/distortion.h>

#include "apps/iclk/io/undistorter.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;

const char* const kEuroc =
    "# General sensor definitions.\n"
    "sensor_type: camera\n"
    "comment: VI-Sensor cam0 (MT9M034)\n"
    "\n"
    "T_BS:\n"
    "  cols: 4\n"
    "  rows: 4\n"
    "  data: [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,\n"
    "         0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,\n"
    "        -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,\n"
    "         0.0, 0.0, 0.0, 1.0]\n"
    "rate_hz: 20\n"
    "resolution: [752, 480]\n"
    "camera_model: pinhole\n"
    "intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv\n"
    "distortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]\n";

const char* const kKalibr =
    "cam0:\n"
    "  cam_overlaps: [1]\n"
    "  camera_model: pinhole\n"
    "  distortion_coeffs: [-0.01, 0.02, -0.03, 0.04]\n"
    "  distortion_model: equidistant\n"
    "  intrinsics:\n"
    "  - 461.6\n"
    "  - 460.3\n"
    "  - 362.7\n"
    "  - 248.1\n"
    "  resolution: [752, 480]\n"
    "  rostopic: /cam0/image_raw\n"
    "cam1:\n"
    "  T_cn_cnm1:\n"
    "  - [0.99, 0.0, 0.0, -0.1]\n"
    "  - [0.0, 0.99, 0.0, 0.0]\n"
    "  camera_model: pinhole\n"
    "  intrinsics: [1, 2, 3, 4]\n"
    "  resolution: [10, 20]\n";

TEST(CameraFile, Inline) {
  const CameraFile a = load_camera("517.3, 516.5,318.6,255.3");
  EXPECT_EQ(a.camera.fx, 517.3);
  EXPECT_EQ(a.camera.cy, 255.3);
  EXPECT_EQ(a.camera.width, 0);
  const CameraFile b = load_camera("481.2,-480,319.5,239.5,640,480");
  EXPECT_EQ(b.camera.fy, -480);
  EXPECT_EQ(b.camera.width, 640);
  EXPECT_EQ(b.camera.height, 480);
}

TEST(CameraFile, InlineErrors) {
  expect_error([] { load_camera("517.3,516.5,318.6"); }, ErrorCode::invalid_argument, {"517.3,516.5,318.6", "3 numbers"});
  expect_error([] { load_camera("0,516.5,318.6,255.3"); }, ErrorCode::invalid_argument, {"focal length"});
  expect_error([] { load_camera("1,1,1,1,0,480"); }, ErrorCode::invalid_argument, {"image size"});
  expect_error([] { load_camera("1,1,1,1,640.5,480"); }, ErrorCode::invalid_argument, {"image size"});
  expect_error([] { load_camera("1,1,1,1,1e30,480"); }, ErrorCode::invalid_argument, {"image size"});
  expect_error([] { load_camera(""); }, ErrorCode::invalid_argument, {"--camera"});
  expect_error([] { load_camera("no_such_camera.yaml"); }, ErrorCode::io, {"no_such_camera.yaml"});
}

TEST(CameraFile, CameraTxt) {
  const Folder folder;
  const CameraFile a = load_camera(
      folder.write("camera.txt", "# fx fy cx cy width height depth_scale: a comment\n517.3 516.5 318.6 255.3 640 480 5000\n"));
  EXPECT_EQ(a.camera.width, 640);
  EXPECT_EQ(a.depth_scale, 5000);
  expect_error([&] { load_camera(folder.write("c.txt", "517.3 516.5 318.6 255.3 640\n")); }, ErrorCode::invalid_argument,
               {"c.txt", "5 numbers"});
  expect_error([&] { load_camera(folder.write("c.txt", "517.3 516.5 318.6 255.3 640 480 0\n")); }, ErrorCode::invalid_argument,
               {"depth_scale"});
  expect_error([&] { load_camera(folder.write("c.txt", "517.3 a 318.6 255.3\n")); }, ErrorCode::invalid_argument,
               {"c.txt", "'a'"});
  expect_error([&] { load_camera(folder.write("c.txt", "nan 1 318.6 255.3\n")); }, ErrorCode::invalid_argument,
               {"c.txt", "finite"});
  expect_error([&] { load_camera(folder.write("c.txt", "# only a comment\n")); }, ErrorCode::invalid_argument, {"c.txt"});
  expect_error([&] { load_camera(folder.write("c.txt", "")); }, ErrorCode::invalid_argument, {"c.txt", "empty"});
}

TEST(CameraFile, Euroc) {
  const Folder folder;
  const CameraFile a = load_camera(folder.write("sensor.yaml", kEuroc));
  EXPECT_EQ(a.camera.fx, 458.654);
  EXPECT_EQ(a.camera.cy, 248.375);
  EXPECT_EQ(a.camera.width, 752);
  EXPECT_EQ(a.distortion.model, Distortion::Model::radtan);
  ASSERT_EQ(a.distortion.k.size(), 4u);
  EXPECT_EQ(a.distortion.k[3], 1.76187114e-05);
}

TEST(CameraFile, Kalibr) {
  const Folder folder;
  const CameraFile a = load_camera(folder.write("camchain.yaml", kKalibr));
  EXPECT_EQ(a.camera.fy, 460.3);
  EXPECT_EQ(a.camera.height, 480);
  EXPECT_EQ(a.distortion.model, Distortion::Model::equidistant);
  EXPECT_EQ(a.distortion.k[3], 0.04);
}

TEST(CameraFile, MissingKeysAreNamed) {
  const Folder folder;
  const auto without = [&](std::string text, const std::string& key) {
    const size_t begin = text.find(key + ":"), end = text.find('\n', begin);
    return folder.write("broken.yaml", text.erase(begin, end - begin + 1));
  };
  for (const char* key : {"resolution", "intrinsics", "distortion_coefficients", "distortion_model"})
    expect_error([&] { load_camera(without(kEuroc, key)); }, ErrorCode::invalid_argument, {"broken.yaml", key});
  expect_error([&] { load_camera(without(kKalibr, "  resolution")); }, ErrorCode::invalid_argument,
               {"broken.yaml", "cam0.resolution"});
  expect_error([&] { load_camera(folder.write("broken.yaml", "image_width: 640\n")); }, ErrorCode::invalid_argument,
               {"broken.yaml", "intrinsics", "camera_matrix"});
}

TEST(CameraFile, OpenCvStorageAsOpenCvWritesIt) {
  const Folder folder;
  {
    cv::FileStorage out(folder.path("cv.yml"), cv::FileStorage::WRITE);
    out << "calibration_time"
        << "Thu 01 Jan 1970 12:00:00"
        << "image_width" << 640 << "image_height" << 480;
    out << "camera_matrix" << cv::Mat((cv::Mat_<double>(3, 3) << 517.3, 0, 318.6, 0, 516.5, 255.3, 0, 0, 1));
    out << "distortion_coefficients" << cv::Mat((cv::Mat_<double>(5, 1) << 0.2624, -0.9531, -0.0054, 0.0026, 1.1633));
  }
  const CameraFile a = load_camera(folder.path("cv.yml"));
  EXPECT_EQ(a.camera.fx, 517.3);
  EXPECT_EQ(a.camera.fy, 516.5);
  EXPECT_EQ(a.camera.cx, 318.6);
  EXPECT_EQ(a.camera.cy, 255.3);
  EXPECT_EQ(a.camera.width, 640);
  EXPECT_EQ(a.distortion.model, Distortion::Model::radtan);
  ASSERT_EQ(a.distortion.k.size(), 5u);
  EXPECT_EQ(a.distortion.k[4], 1.1633);
  // Without the matrix the file still parses; the message names the keys that would do.
  std::string text = test::bytes_of(folder.path("cv.yml"));
  text.replace(text.find("camera_matrix"), 13, "camera_m_____");
  expect_error([&] { load_camera(folder.write("cv2.yml", text)); }, ErrorCode::invalid_argument, {"cv2.yml", "camera_matrix"});
}

TEST(CameraFile, HostileYaml) {
  const Folder folder;
  const auto load = [&](const std::string& text) { return [&, text] { load_camera(folder.write("h.yaml", text)); }; };
  expect_error(load("intrinsics: [1, 2, 3\n"), ErrorCode::invalid_argument, {"h.yaml", "truncated"});
  expect_error(load("intrinsics: [1, 2, x, 4]\nresolution: [1, 1]\n"), ErrorCode::invalid_argument, {"intrinsics", "'x'"});
  expect_error(load("intrinsics: [1, 2, 4]\nresolution: [1, 1]\n"), ErrorCode::invalid_argument, {"intrinsics", "3 numbers"});
  expect_error(load("intrinsics: ]]]]\n"), ErrorCode::invalid_argument, {"h.yaml"});
  expect_error(load(std::string("intrinsics: \0\n", 14)), ErrorCode::invalid_argument, {"h.yaml:1"});
  expect_error(load("camera_model: omni\n" + std::string(kEuroc).erase(std::string(kEuroc).find("camera_model: pinhole"), 22)),
               ErrorCode::invalid_argument, {"omni"});
  std::string deep;
  for (int i = 0; i < 1000; ++i) deep += std::string(static_cast<size_t>(i), ' ') + "a:\n";
  expect_error(load("x: 1\n" + deep), ErrorCode::invalid_argument, {"h.yaml"});
  expect_error(load("x: [" + std::string(300000, ',') + "]\n"), ErrorCode::invalid_argument, {"h.yaml"});
}

TEST(CameraFile, FitsTheImage) {
  const CameraFile file = load_camera("500,500,319.5,239.5,640,480");
  const Camera half = fit_camera(file, 320, 240);
  EXPECT_DOUBLE_EQ(half.fx, 250);
  EXPECT_DOUBLE_EQ(half.cx, 159.5);
  EXPECT_EQ(half.width, 320);
  const Camera same = fit_camera(file, 640, 480);
  EXPECT_DOUBLE_EQ(same.cx, 319.5);
  EXPECT_NO_THROW(fit_camera(file, 213, 160));  // 640 / 3 rounded
  expect_error([&] { fit_camera(file, 640, 360); }, ErrorCode::invalid_argument, {"640x480", "640x360"});
  EXPECT_EQ(fit_camera(load_camera("500,500,319.5,239.5"), 640, 360).height, 360);
}

TEST(Distortion, Text) {
  EXPECT_EQ(parse_distortion("radtan:1,2,3,4").k.size(), 4u);
  EXPECT_EQ(parse_distortion("radtan:1,2,3,4,5").k[4], 5);
  EXPECT_EQ(parse_distortion("equidistant:1,2,3,4").model, Distortion::Model::equidistant);
  EXPECT_TRUE(parse_distortion("none").empty());
  expect_error([] { parse_distortion("radtan:1,2,3"); }, ErrorCode::invalid_argument, {"4, 5 or 8", "3"});
  expect_error([] { parse_distortion("equidistant:1,2,3,4,5"); }, ErrorCode::invalid_argument, {"4 coefficients"});
  expect_error([] { parse_distortion("radtan"); }, ErrorCode::invalid_argument, {"radtan", "0"});
  expect_error([] { parse_distortion("brown:1,2,3,4"); }, ErrorCode::invalid_argument, {"brown"});
  expect_error([] { parse_distortion("radtan:1,b,3,4"); }, ErrorCode::invalid_argument, {"'b'"});
  expect_error([] { parse_distortion("radtan:1,nan,3,4"); }, ErrorCode::invalid_argument, {"finite"});
}

/// The lens as the formulas say it.
Eigen::Vector2d distort(const Camera& c, const Distortion& d, const Eigen::Vector2d& uv) {
  const double x = (uv.x() - c.cx) / c.fx, y = (uv.y() - c.cy) / c.fy, r2 = x * x + y * y;
  if (d.model == Distortion::Model::radtan) {
    double radial = 1 + r2 * (d.k[0] + r2 * (d.k[1] + r2 * (d.k.size() > 4 ? d.k[4] : 0)));
    if (d.k.size() > 5) radial /= 1 + r2 * (d.k[5] + r2 * (d.k[6] + r2 * d.k[7]));
    return {c.fx * (x * radial + 2 * d.k[2] * x * y + d.k[3] * (r2 + 2 * x * x)) + c.cx,
            c.fy * (y * radial + d.k[2] * (r2 + 2 * y * y) + 2 * d.k[3] * x * y) + c.cy};
  }
  const double r = std::sqrt(r2), t = std::atan(r), t2 = t * t;
  const double s = r > 0 ? t * (1 + t2 * (d.k[0] + t2 * (d.k[1] + t2 * (d.k[2] + t2 * d.k[3])))) / r : 1;
  return {c.fx * x * s + c.cx, c.fy * y * s + c.cy};
}

TEST(Distortion, PointsAndImagesFollowTheFormulas) {
  const Camera camera{517.3, 516.5, 318.6, 255.3, 640, 480};
  for (const char* text : {"radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633", "radtan:-0.28,0.07,0.0002,0.00002",
                           "radtan:0.3,-0.2,0.001,-0.002,0.05,0.5,-0.1,0.02", "equidistant:-0.01,0.02,-0.01,0.005"}) {
    const Distortion d = parse_distortion(text);
    const Undistorter undistort(camera, d);
    // The distorted image's value at a pixel is that pixel's column (row): undistorted, it says where the value came from.
    cv::Mat columns(480, 640, CV_32FC1), rows(480, 640, CV_32FC1);
    for (int v = 0; v < 480; ++v)
      for (int u = 0; u < 640; ++u)
        columns.at<float>(v, u) = static_cast<float>(u), rows.at<float>(v, u) = static_cast<float>(v);
    const cv::Mat from_u = undistort.image(columns), from_v = undistort.image(rows), nearest_u = undistort.depth(columns);
    for (const Eigen::Vector2d& uv : {Eigen::Vector2d(100, 80), Eigen::Vector2d(320, 240), Eigen::Vector2d(500, 400)}) {
      const Eigen::Vector2d source = distort(camera, d, uv);
      const int u = static_cast<int>(uv.x()), v = static_cast<int>(uv.y());
      EXPECT_NEAR(from_u.at<float>(v, u), source.x(), 0.05) << text;
      EXPECT_NEAR(from_v.at<float>(v, u), source.y(), 0.05) << text;
      EXPECT_EQ(nearest_u.at<float>(v, u), std::round(nearest_u.at<float>(v, u))) << "depth must not be interpolated";
      EXPECT_NEAR(nearest_u.at<float>(v, u), source.x(), 0.55) << text;
      EXPECT_NEAR((undistort.point(source) - uv).norm(), 0, 1e-3) << text;
      EXPECT_LT((undistort.source(uv) - source).norm(), 1e-9) << text;
    }
  }
}

TEST(Distortion, WhatWasNotSeenHasNoDepth) {
  const Camera camera{300, 300, 159.5, 119.5, 320, 240};
  const Undistorter undistort(camera,
                              parse_distortion("radtan:0.5,0,0,0"));  // pincushion: the corners come from outside the image
  const cv::Mat depth = undistort.depth(cv::Mat(240, 320, CV_32FC1, cv::Scalar(2)));
  EXPECT_EQ(undistort.seen().at<uchar>(0, 0), 0);
  EXPECT_EQ(depth.at<float>(0, 0), 0);
  EXPECT_EQ(undistort.seen().at<uchar>(120, 160), 255);
  EXPECT_EQ(depth.at<float>(120, 160), 2);
  // A barrel strong enough folds the image back: r (1 - r^2) falls beyond r = 0.577.
  const Undistorter folding({150, 150, 159.5, 119.5, 320, 240}, parse_distortion("radtan:-1,0,0,0"));
  EXPECT_EQ(folding.seen().at<uchar>(120, 155 + 130), 0);
  EXPECT_EQ(folding.seen().at<uchar>(120, 155), 255);
  EXPECT_LT(folding.source({10000, 119.5}).x(), 159.5 + 150 * 0.385) << "beyond the lens's domain, its edge";
}

TEST(Distortion, ATurnedCameraSeesAlongItsOwnAxis) {
  const Camera camera{300, 300, 159.5, 119.5, 320, 240};
  const Eigen::Matrix3d R = SE3::exp((Vector6d() << 0, 0, 0, 0.03, -0.05, 0.1).finished()).R;
  const Undistorter turned(camera, {}, camera, R);
  // A plane, n X = 1, seen by the camera and by the turned one.
  const Eigen::Vector3d n(0.05, -0.1, 0.5), n_turned = R * n;
  cv::Mat depth(240, 320, CV_32FC1);
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 320; ++u) depth.at<float>(v, u) = static_cast<float>(1 / n.dot(camera.ray({u, v})));
  const cv::Mat out = turned.depth(depth);
  // A point is the same one, seen by the turned camera, which has a lens as well.
  const Camera as{280, 285, 150, 110, 320, 240};
  for (const char* lens : {"none", "radtan:-0.28,0.07,0.0002,0.00002", "equidistant:-0.01,0.02,-0.01,0.005"}) {
    const Undistorter undistort(camera, parse_distortion(lens), as, R);
    const Eigen::Vector2d uv(200, 90);
    const Eigen::Vector3d X = R.transpose() * as.ray(uv) * 3;
    const Features seen{{undistort.source(uv)}, {1 / X.z()}, {0.1 / X.z()}}, out_of = undistort.features(seen);
    EXPECT_LT((out_of.uv[0] - uv).norm(), 1e-3) << lens;
    EXPECT_NEAR(out_of.inverse_depth[0], 1.0 / 3, 1e-5) << lens;
    EXPECT_NEAR(out_of.inverse_depth_sigma[0], 0.1 / 3, 1e-6) << lens;
  }
  for (const Eigen::Vector2d& uv : {Eigen::Vector2d(60, 50), Eigen::Vector2d(160, 120), Eigen::Vector2d(260, 190)}) {
    const float z = out.at<float>(static_cast<int>(uv.y()), static_cast<int>(uv.x()));
    EXPECT_NEAR(z, 1 / n_turned.dot(camera.ray(uv)), 1e-3) << "half a pixel of slope";
  }
}

TEST(Distortion, NoneTouchesNothing) {
  const Undistorter undistort({300, 300, 159.5, 119.5, 320, 240}, {});
  EXPECT_TRUE(undistort.seen().empty());
  EXPECT_EQ(undistort.point({3.25, 4.5}), Eigen::Vector2d(3.25, 4.5));
}

}  // namespace
}  // namespace iclk
