// iclk track on a stereo recording in EuRoC's layout: a rig that flies over terrain made in code, whose cameras lean and whose
// lenses differ.
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>

#include "apps/iclk/io/euroc.h"

#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

namespace fs = std::filesystem;

constexpr int kFrames = 16;
const Camera kLeft{300, 300, 187.5, 119.5, 376, 240}, kRight{310, 309, 190, 121, 376, 240};

SE3 rotated(double x, double y, double z, const Eigen::Vector3d& t) {
  return SE3::exp((Vector6d() << Eigen::Vector3d::Zero(), x, y, z).finished()) * SE3{Eigen::Matrix3d::Identity(), t};
}
const SE3 kT_bl = rotated(0.1, -0.2, 1.5, {0.3, 0.1, -0.2});  // left camera to body
const SE3 kT_rl = rotated(0.01, -0.015, 0.008, {-12, 0.3, 0.2});

SE3 left_pose(int i) {
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  const double a = 0.06 * i;
  return {Eigen::AngleAxisd(0.5 * a, Eigen::Vector3d::UnitZ()).toRotationMatrix() * down,
          Eigen::Vector3d(120 + 40 * std::cos(a), 120 + 40 * std::sin(a), 150 + 2 * std::sin(2 * a))};
}

/// What a lens of radial distortion k1 makes of a pinhole's view: the pixel that is seen at a distorted one.
cv::Mat through_lens(const cv::Mat& image, const Camera& c, double k1) {
  cv::Mat u(image.size(), CV_32FC1), v(image.size(), CV_32FC1), out;
  for (int y = 0; y < image.rows; ++y)
    for (int x = 0; x < image.cols; ++x) {
      const Eigen::Vector2d d((x - c.cx) / c.fx, (y - c.cy) / c.fy);
      Eigen::Vector2d p = d;
      for (int i = 0; i < 20; ++i) p = d / (1 + k1 * p.squaredNorm());
      u.at<float>(y, x) = static_cast<float>(c.fx * p.x() + c.cx);
      v.at<float>(y, x) = static_cast<float>(c.fy * p.y() + c.cy);
    }
  cv::remap(image, out, u, v, cv::INTER_CUBIC, cv::BORDER_REPLICATE);
  return out;
}

std::string matrix_text(const SE3& T) {
  std::string text;
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) text += fmt::format("{}{:.12g}", text.empty() ? "" : ", ", T.matrix()(i, j));
  return text;
}

std::string sensor(const SE3& T_bs, const Camera& c, double k1) {
  return fmt::format(
      "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{}]\nrate_hz: 20\nresolution: [{}, {}]\ncamera_model: "
      "pinhole\n"
      "intrinsics: [{}, {}, {}, {}]\ndistortion_model: radial-tangential\ndistortion_coefficients: [{}, 0, 0, 0]\n",
      matrix_text(T_bs), c.width, c.height, c.fx, c.fy, c.cx, c.cy, k1);
}

void write_recording(const Folder& folder) {
  const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256}));
  TerrainRenderer renderer(device(), terrain);
  std::string lists[2] = {"#timestamp [ns],filename\n", "#timestamp [ns],filename\n"}, truth = "#timestamp, p, q\n";
  for (const char* name : {"mav0/cam0/data", "mav0/cam1/data", "mav0/state_groundtruth_estimate0"})
    fs::create_directories(folder.path(name));
  for (int i = 0; i < kFrames; ++i) {
    const std::string stamp = std::to_string(1403636579763555584 + 50000000LL * i);
    const SE3 T_wl = left_pose(i), T_wb = T_wl * kT_bl.inverse();
    for (int side = 0; side < 2; ++side) {
      const Camera& camera = side ? kRight : kLeft;
      const View view = renderer.render(camera, side ? T_wl * kT_rl.inverse() : T_wl);
      cv::Mat rgba(camera.height, camera.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data())), grey;
      cv::cvtColor(rgba, grey, cv::COLOR_RGBA2GRAY);
      cv::imwrite(folder.path(fmt::format("mav0/cam{}/data/{}.png", side, stamp)),
                  through_lens(grey, camera, side ? -0.04 : -0.08));
      if (side == 0 || i != 5) lists[side] += stamp + "," + stamp + ".png\n";  // the right camera dropped one
    }
    const Eigen::Quaterniond q(T_wb.R);
    truth += fmt::format("{},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},0,0,0\n", stamp, T_wb.t.x(), T_wb.t.y(),
                         T_wb.t.z(), q.w(), q.x(), q.y(), q.z());
  }
  folder.write("mav0/cam0/data.csv", lists[0]);
  folder.write("mav0/cam1/data.csv", lists[1]);
  folder.write("mav0/cam0/sensor.yaml", sensor(kT_bl, kLeft, -0.08));
  folder.write("mav0/cam1/sensor.yaml", sensor(kT_bl * kT_rl.inverse(), kRight, -0.04));
  folder.write("mav0/state_groundtruth_estimate0/data.csv", truth);
}

double number_after(const std::string& text, const std::string& words) {
  const size_t at = text.find(words);
  return at == std::string::npos ? NAN : std::atof(text.c_str() + at + words.size());
}

TEST(TrackEuroc, AStereoRigOverTerrain) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  write_recording(folder);
  const Sequence sequence = load_euroc_sequence(*euroc_root(folder.path("")));
  ASSERT_EQ(sequence.frames.size(), static_cast<size_t>(kFrames - 1));
  EXPECT_LT((sequence.frames[3].T_wc->matrix() - left_pose(3).matrix()).norm(), 1e-6);
  EXPECT_LT((sequence.rig->T_rl.matrix() - kT_rl.matrix()).norm(), 1e-6);

  const Finished f = run({"track", folder.path(""), "--out", folder.path("out")});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("15 tracked, 0 of them not confirmed"), std::string::npos) << f.out;
  EXPECT_LT(number_after(f.out.substr(f.out.find("adjusted")), "), "), 0.5) << f.out;  // % of the way
  expect_lines_of("frame-1.json", folder.path("out/frames.jsonl"));
}

TEST(TrackEuroc, BrokenRecordingsAreNamed) {
  const Folder folder;
  EXPECT_FALSE(euroc_root(folder.path("")));
  for (const char* name : {"cam0", "cam1"}) fs::create_directories(folder.path(name));
  folder.write("cam0/data.csv", "1,a.png\n");
  ASSERT_EQ(euroc_root(folder.path("")), folder.path(""));
  expect_error([&] { load_euroc_sequence(folder.path("")); }, ErrorCode::io, {"sensor.yaml"});
  folder.write("cam0/sensor.yaml", sensor(kT_bl, kLeft, 0));
  folder.write("cam1/sensor.yaml", sensor(kT_bl * kT_rl.inverse(), kRight, 0));
  expect_error([&] { load_euroc_sequence(folder.path("")); }, ErrorCode::io, {"cam1/data.csv"});
  folder.write("cam1/data.csv", "soon,a.png\n");
  expect_error([&] { load_euroc_sequence(folder.path("")); }, ErrorCode::invalid_argument, {"data.csv:1", "soon"});
  folder.write("cam1/data.csv", "2000000,a.png\n");
  expect_error([&] { load_euroc_sequence(folder.path("")); }, ErrorCode::invalid_argument, {"same time"});
  // Cameras that stand behind each other.
  folder.write("cam1/data.csv", "1,a.png\n");
  for (const char* name : {"cam0", "cam1"}) {
    fs::create_directories(folder.path(std::string(name) + "/data"));
    cv::imwrite(folder.path(std::string(name) + "/data/a.png"), cv::Mat(240, 376, CV_8UC1, cv::Scalar(90)));
  }
  folder.write("cam1/sensor.yaml", sensor(kT_bl * SE3{Eigen::Matrix3d::Identity(), {-12, 0, 0}}, kRight, 0));
  const Finished f = run({"track", folder.path("")});
  EXPECT_EQ(f.code, 3);
  EXPECT_NE(f.err.find("right"), std::string::npos) << f.err;
}

TEST(TrackEuroc, ARigThatIsRectifiedAlreadyNeedsNoMask) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  for (const char* name : {"cam0", "cam1"}) {
    fs::create_directories(folder.path(std::string(name) + "/data"));
    cv::imwrite(folder.path(std::string(name) + "/data/a.png"), cv::Mat(240, 376, CV_8UC1, cv::Scalar(90)));
    folder.write(std::string(name) + "/data.csv", "1,a.png\n");
  }
  folder.write("cam0/sensor.yaml", sensor(kT_bl, kLeft, 0));
  folder.write("cam1/sensor.yaml", sensor(kT_bl * SE3{Eigen::Matrix3d::Identity(), {12, 0, 0}}, kLeft, 0));
  const Finished f = run({"track", folder.path("")});
  EXPECT_EQ(f.code, 14) << f.err;
  EXPECT_NE(f.out.find("1 lost"), std::string::npos) << f.out;  // no texture
}

}  // namespace
}  // namespace iclk::test
