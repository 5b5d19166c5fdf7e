// iclk stereo as a user runs it: rendered rigs with lenses of their own, formats there and back, what goes wrong.
#include <cmath>
#include <filesystem>
#include <functional>
#include <sstream>

#include <Eigen/LU>
#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/io/stereo_file.h"
#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

namespace fs = std::filesystem;
const Camera kLeft{250, 250, 159.5, 119.5, 320, 240}, kRight{262, 260, 163, 117, 328, 236};
const std::vector<double> kLens = {-0.12, 0.04, 0.001, -0.0015};
const SE3 kOld{Eigen::Matrix3d::Identity(), {-1.2, 0.01, 0}};
constexpr double kDegree = M_PI / 180;

SE3 shocked(double degrees) {
  Vector6d xi;
  xi << 0.003, -0.002, 0.003, degrees * kDegree * Eigen::Vector3d(0.6, -0.5, 0.62).normalized();
  return kOld * SE3::exp(xi);
}

/// Kalibr's camchain as its tool writes it, with what belongs to others.
std::string camchain() {
  return "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [0, 0, 0, 0]\n  distortion_model: radtan\n"
         "  intrinsics: [250, 250, 159.5, 119.5]\n  resolution: [320, 240]\n  rostopic: /left  # mine\n"
         "cam1:\n  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -1.2]\n  - [0.0, 1.0, 0.0, 0.01]\n  - [0.0, 0.0, 1.0, 0.0]\n"
         "  - [0.0, 0.0, 0.0, 1.0]\n  cam_overlaps: [0]\n  camera_model: pinhole\n"
         "  distortion_coeffs: [-0.12, 0.04, 0.001, -0.0015]\n  distortion_model: radtan\n"
         "  intrinsics: [262, 260, 163, 117]\n  resolution: [328, 236]\n  rostopic: /right\n";
}

cv::Mat grey(const View& view) {
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  cv::Mat out;
  cv::cvtColor(rgba, out, cv::COLOR_RGBA2GRAY);
  return out;
}

/// A pinhole's picture as the right lens has it, from a pinhole with a wider view.
cv::Mat through_lens(const cv::Mat& wide, const Camera& wide_camera) {
  std::vector<cv::Point2f> pixels, rays;
  for (int v = 0; v < kRight.height; ++v)
    for (int u = 0; u < kRight.width; ++u) pixels.emplace_back(static_cast<float>(u), static_cast<float>(v));
  const cv::Matx33d K(kRight.fx, 0, kRight.cx, 0, kRight.fy, kRight.cy, 0, 0, 1);
  cv::undistortPoints(pixels, rays, K, kLens, cv::noArray(), cv::noArray(), {cv::TermCriteria::COUNT, 50, 0});
  cv::Mat map(kRight.height, kRight.width, CV_32FC2), out;
  for (size_t i = 0; i < rays.size(); ++i)
    map.at<cv::Point2f>(static_cast<int>(i) / kRight.width, static_cast<int>(i) % kRight.width) = {
        static_cast<float>(wide_camera.fx * rays[i].x + wide_camera.cx),
        static_cast<float>(wide_camera.fy * rays[i].y + wide_camera.cy)};
  cv::remap(wide, out, map, cv::noArray(), cv::INTER_LINEAR);
  return out;
}

class Stereo : public ::testing::Test {
 protected:
  /// A recording of a rig whose pair i is T_rl(i); made in `name`.
  static std::string record(const std::string& name, int count, const std::function<SE3(int)>& T_rl) {
    static const auto terrain = std::make_shared<const Terrain>(
        procedural_terrain({.seed = 5, .size = 128, .mosaic_step = 0.08, .relief_step = 0.5, .relief = 15}));
    static TerrainRenderer renderer(device(), terrain);
    const std::string root = folder().path(name);
    for (const char* part : {"left", "right", "depth"}) fs::create_directories(fs::path(root) / part);
    const Camera wide{262, 260, 209.5, 159.5, 420, 320};
    Eigen::Matrix3d down;
    down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    for (int i = 0; i < count; ++i) {
      const double x = 45 + 5 * i, y = 50 + 4 * i;
      const SE3 T_WC{SE3::exp((Vector6d() << 0, 0, 0, 0, 0, 0.7 * i).finished()).R * down *
                         SE3::exp((Vector6d() << 0, 0, 0, 0.2, 0, 0).finished()).R,
                     {x, y, terrain->height_at(x, y).value_or(0) + 22}};
      const View left = renderer.render(kLeft, T_WC), right = renderer.render(wide, T_WC * T_rl(i).inverse());
      const std::string file = std::to_string(i);
      cv::imwrite(root + "/left/" + file + ".png", grey(left));
      cv::imwrite(root + "/right/" + file + ".png", through_lens(grey(right), wide));
      cv::imwrite(root + "/depth/" + file + ".exr", cv::Mat(240, 320, CV_32FC1, const_cast<float*>(left.depth.data())));
    }
    folder().write(name + ".yaml", camchain());
    return root;
  }
  static const std::string& knocked() {
    static const std::string root = record("knocked", 5, [](int) { return shocked(1); });
    return root;
  }
  static Folder& folder() {
    static Folder folder;
    return folder;
  }
};

TEST_F(Stereo, ARigThatWasKnocked) {
  ICLK_NEED_DEVICE();
  const std::string out = folder().path("out"), calibration = knocked() + ".yaml";
  const Finished f = run({"stereo", knocked(), "--calibration", calibration, "--out", out});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("has moved"), std::string::npos) << f.out;
  // The file that a user goes on with says it all.
  const StereoFile found = load_stereo(out + "/knocked.yaml");
  EXPECT_LT((found.T_rl.inverse() * shocked(1)).angle(), 0.03 * kDegree);
  EXPECT_LT((found.T_rl.t - shocked(1).t).norm(), 0.02);
  EXPECT_EQ(found.right.distortion.k, kLens);
  EXPECT_NE(bytes_of(out + "/knocked.yaml").find("rostopic: /left  # mine"), std::string::npos);
  const auto json = nlohmann::json::parse(bytes_of(out + "/result.json"));
  EXPECT_TRUE(json.at("moved"));
  EXPECT_FALSE(json.at("scale_from_prior"));
  EXPECT_GT(json.at("epipolar_before_px"), 1.5);
  EXPECT_LT(json.at("epipolar_after_px"), 0.2);
  EXPECT_EQ(json.at("pairs").size(), 5u);
  EXPECT_EQ(json.at("covariance").size(), 6u);
  const cv::Mat picture = cv::imread(out + "/epipolar.png");
  EXPECT_EQ(picture.cols, 640);
  EXPECT_EQ(picture.rows, 480);
  // With the new calibration nothing has moved.
  const Finished again = run({"stereo", knocked(), "--calibration", out + "/knocked.yaml"});
  EXPECT_EQ(again.code, 0) << again.err;
  EXPECT_NE(again.out.find("has not moved"), std::string::npos) << again.out;
}

TEST_F(Stereo, WithoutDepthTheBaselineKeepsItsLength) {
  ICLK_NEED_DEVICE();
  const std::string out = folder().path("no_depth");
  const Finished f = run({"stereo", "--left", knocked() + "/left", "--right", knocked() + "/right", "--distance", "22",
                          "--calibration", knocked() + ".yaml", "--out", out});
  ASSERT_EQ(f.code, 0) << f.err << f.out;
  EXPECT_NE(f.out.find("scale      from the old calibration"), std::string::npos) << f.out;
  const SE3 found = load_stereo(out + "/knocked.yaml").T_rl;
  EXPECT_NEAR(found.t.norm(), kOld.t.norm(), 5e-3);
  EXPECT_LT(nlohmann::json::parse(bytes_of(out + "/result.json")).at("epipolar_after_px"), 0.3);
}

TEST_F(Stereo, ARigThatBends) {
  ICLK_NEED_DEVICE();
  const auto bend = [](int i) {
    return kOld * SE3::exp((Vector6d() << 0, 0.02, 0.02, 0.01, 0.01, 0.04).finished() * std::sin(1.1 * i));
  };
  const std::string root = record("wing", 6, bend), out = folder().path("wing_out");
  const Finished f = run({"stereo", root, "--calibration", root + ".yaml", "--flex", "--rate", "20", "--out", out});
  ASSERT_EQ(f.code, 0) << f.err;
  std::istringstream series(bytes_of(out + "/series.csv"));
  std::string line;
  std::getline(series, line);
  EXPECT_EQ(line.rfind("time,tx,ty,tz,qx,qy,qz,qw", 0), 0u);
  int count = 0;
  for (; std::getline(series, line); ++count) {
    const std::vector<double> n = parse_numbers(line, "series");
    ASSERT_EQ(n.size(), 11u);
    EXPECT_NEAR(n[0], count / 20.0, 1e-6);
    EXPECT_LT((pose_from_tum(&n[1], "series").inverse() * bend(count)).angle(), 0.15 * kDegree) << count;
  }
  EXPECT_EQ(count, 6);
}

/// Middlebury's motorcycle with depths from a stereo matcher by its own calibration, the right image turned by a homography.
TEST_F(Stereo, AMotorcycleWhoseRightCameraWasTurned) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("middlebury_motorcycle");
  if (data.empty()) GTEST_SKIP() << test::no_data("middlebury_motorcycle");
  const Folder own;
  const cv::Mat left = cv::imread(data + "/motorcycle_left.png"), right = cv::imread(data + "/motorcycle_right.png");
  cv::Mat disparity, depth;
  cv::StereoSGBM::create(0, 80, 5, 200, 800, 1, 0, 10, 100, 2)->compute(left, right, disparity);
  disparity.convertTo(depth, CV_32FC1, 1 / 16.0);
  for (float& d : cv::Mat_<float>(depth)) d = d > 1 ? 994.978f * 0.193001f / (d + 31.086f) : 0;
  cv::imwrite(own.path("left.png"), left);
  cv::imwrite(own.path("depth.exr"), depth);
  const std::string chain =
      own.write("chain.yaml",
                "cam0:\n  camera_model: pinhole\n  intrinsics: [994.978, 994.978, 311.193, 254.877]\n  resolution: [741, 500]\n"
                "cam1:\n  camera_model: pinhole\n  intrinsics: [994.978, 994.978, 342.279, 254.877]\n  resolution: [741, 500]\n"
                "  T_cn_cnm1: [[1, 0, 0, -0.193001], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n");
  const Eigen::Matrix3d K = (Eigen::Matrix3d() << 994.978, 0, 342.279, 0, 994.978, 254.877, 0, 0, 1).finished();
  SE3 unturned;
  for (const double degrees : {0.0, 1.0, 3.0}) {
    Vector6d xi;
    xi << 0, 0, 0, degrees * kDegree * Eigen::Vector3d(0.7, -0.4, 0.59).normalized();
    const SE3 turn = SE3::exp(xi);
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> H = K * turn.R * K.inverse();
    cv::Mat turned;
    cv::warpPerspective(right, turned, cv::Mat(3, 3, CV_64F, const_cast<double*>(H.data())), right.size(), cv::INTER_CUBIC);
    cv::imwrite(own.path("right.png"), turned);
    own.write("one.jsonl", "{\"left\": \"left.png\", \"right\": \"right.png\", \"depth\": \"depth.exr\"}\n");
    const std::string out = own.path("out");
    const Finished f =
        run({"stereo", own.path("one.jsonl"), "--calibration", chain, "--depth-sigma", "stereo:0.5,0.193", "--out", out});
    ASSERT_EQ(f.code, 0) << f.err << f.out;
    EXPECT_EQ(f.out.find("has not moved") == std::string::npos, degrees > 0) << f.out;
    const SE3 found = load_stereo(out + "/chain.yaml").T_rl;
    if (degrees == 0) unturned = found;
    EXPECT_LT((found.inverse() * turn * unturned).angle(), 0.02 * kDegree) << degrees;
    EXPECT_LT(nlohmann::json::parse(bytes_of(out + "/result.json")).at("epipolar_after_px"), 0.2);
  }
}

TEST_F(Stereo, EveryFormatComesBackWithTheNewPoseAndAllElse) {
  const Folder own;
  own.write("chain.yaml", camchain());
  const std::string sensor =
      "# general\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, X,\n         0, 1, 0, 0,\n"
      "         0, 0, 1, 0,\n         0, 0, 0, 1]\nrate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\n"
      "intrinsics: [458, 457, 367, 248]  # fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
      "distortion_coefficients: [-0.28, 0.07, 0.0002, 1.7e-05]\n";
  for (int i = 0; i < 2; ++i) {
    std::string text = sensor;
    text.replace(text.find('X'), 1, i ? "0.11" : "0.01");
    own.write("mav0/cam" + std::to_string(i) + "/sensor.yaml", text);
  }
  own.write(
      "stereo.yml",
      "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 500., 0., 320., 0., 500., 240.,\n"
      "       0., 0., 1. ]\nD1: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0.1, 0., 0., 0., 0. ]\n"
      "M2: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 510., 0., 330., 0., 510., 250., 0., 0., 1. ]\n"
      "R: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n"
      "T: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -0.1, 0., 0. ]\nrms: 0.2\n");
  for (const std::string name : {"chain.yaml", "mav0", "stereo.yml"}) {
    const StereoFile before = load_stereo(own.path(name));
    EXPECT_LT(before.T_rl.t.x(), -0.09) << name;
    const SE3 T = before.T_rl * SE3::exp((Vector6d() << 0.01, 0.02, -0.01, 0.02, -0.03, 0.01).finished());
    std::string folder_of = "new_" + name;
    for (const auto& [file, text] : with_extrinsics(before, T)) own.write(folder_of + "/" + file, text);
    const StereoFile after = load_stereo(own.path(folder_of + (name == "mav0" ? "" : "/" + name)));
    EXPECT_LT((after.T_rl.inverse() * T).log().norm(), 1e-12) << name;
    EXPECT_EQ(after.right.camera.fx, before.right.camera.fx);
    EXPECT_EQ(after.right.distortion.k, before.right.distortion.k);
    // Written twice, only the numbers of the pose differ from the first time.
    EXPECT_EQ(with_extrinsics(after, T), after.files) << name;
  }
  EXPECT_NE(bytes_of(own.path("new_stereo.yml/stereo.yml")).find("rms: 0.2"), std::string::npos);
  EXPECT_NE(bytes_of(own.path("new_mav0/cam1/sensor.yaml")).find("# fu, fv, cu, cv"), std::string::npos);
}

TEST_F(Stereo, CalibrationsAreWrittenAsTheyWereRead) {
  const Folder own;
  std::string text = camchain();
  text.replace(text.find("cam1:"), 5, "\"cam1\":");
  text.replace(text.find("T_cn_cnm1:"), 10, "\"T_cn_cnm1\":  # from Kalibr");
  text.replace(text.find("  cam_overlaps: [0]"), 0, "  # measured in May\n");
  own.write("chain.yaml", "\xef\xbb\xbf" + text);
  const StereoFile before = load_stereo(own.path("chain.yaml"));
  const SE3 T = before.T_rl * SE3::exp((Vector6d() << 0.01, 0.02, -0.01, 0.02, -0.03, 0.01).finished());
  const std::string written = with_extrinsics(before, T)[0].second;
  own.write("new.yaml", written);
  EXPECT_LT((load_stereo(own.path("new.yaml")).T_rl.inverse() * T).log().norm(), 1e-12);
  for (const char* piece :
       {"# from Kalibr", "# measured in May", "[[", "],\n    [", "\"T_cn_cnm1\": ", "rostopic: /left  # mine"})
    EXPECT_NE(written.find(piece), std::string::npos) << piece << " in\n" << written;
}

TEST_F(Stereo, TwoFilesOfOpenCv) {
  const Folder own;
  const std::string matrix = ": !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ ",
                    K = "500., 0., 320., 0., 500., 240., 0., 0., 1. ]\n", I = "1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n";
  const auto intrinsics = [&](const std::string& d) {
    const std::string D = ": !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ " + d + " ]\n";
    return "%YAML:1.0\n---\nimageSize: [ 640, 480 ]\nM1" + matrix + K + "D1" + D + "M2" + matrix + K + "D2" + D;
  };
  own.write("intrinsics.yml", intrinsics("0.1, 0., 0., 0., 0."));
  own.write("extrinsics.yml", "%YAML:1.0\n---\nR" + matrix + I + "T: [ -0.1, 0., 0. ]\nR1" + matrix + I + "rms: 0.2\n");
  for (const char* name : {"intrinsics.yml", "extrinsics.yml", ""}) {
    const StereoFile file = load_stereo(own.path(name));
    EXPECT_EQ(file.left.camera.width, 640) << name;
    ASSERT_EQ(file.files.size(), 2u);
    const auto out = with_extrinsics(file, {Eigen::Matrix3d::Identity(), {-0.2, 0, 0}});
    EXPECT_EQ(out[0], file.files[0]);
    EXPECT_EQ(out[1].second.find("R1"), std::string::npos) << "of the old pose";
    EXPECT_NE(out[1].second.find("rms: 0.2"), std::string::npos);
  }
  own.write("intrinsics.yml", intrinsics("0.1, 0.2, 0.3, 0.4"));
  expect_error([&] { load_stereo(own.path("intrinsics.yml")); }, ErrorCode::invalid_argument,
               {"cv::fisheye", "distortion_model"});
  own.write("intrinsics.yml", intrinsics("0.1, 0.2, 0.3, 0.4") + "distortion_model: equidistant\n");
  EXPECT_EQ(load_stereo(own.path("intrinsics.yml")).left.distortion.model, Distortion::Model::equidistant);
  fs::remove(own.path("extrinsics.yml"));
  expect_error([&] { load_stereo(own.path("intrinsics.yml")); }, ErrorCode::invalid_argument, {"extrinsics", "missing"});
}

TEST_F(Stereo, GarbageGivesNoCalibration) {
  ICLK_NEED_DEVICE();
  const Folder own;
  std::string text = camchain();
  text.replace(text.find("[328, 236]"), 10, "[320, 240]");
  const std::string left = knocked() + "/left", chain = own.write("chain.yaml", text);
  const Finished same = run({"stereo", "--left", left, "--right", left, "--distance", "22", "--calibration", chain});
  EXPECT_EQ(same.code, 3);
  EXPECT_NE(same.err.find("are the same image"), std::string::npos) << same.err;
  // One pair of five shows the same ground.
  std::string lines;
  const auto file = [](const char* key, const char* name, int i, const char* ending) {
    return std::string("\"") + key + "\": \"" + knocked() + "/" + name + "/" + std::to_string(i) + ending + "\"";
  };
  for (int i = 0; i < 5; ++i)
    lines += "{" + file("left", "left", i, ".png") + ", " + file("right", "right", i == 0 ? 0 : i % 4 + 1, ".png") + ", " +
             file("depth", "depth", i, ".exr") + "}\n";
  own.write("mixed.jsonl", lines);
  const Finished mixed =
      run({"stereo", own.path("mixed.jsonl"), "--calibration", knocked() + ".yaml", "--out", own.path("out")});
  EXPECT_EQ(mixed.code, 14) << mixed.out;
  EXPECT_NE(mixed.out.find("1 of 5 pairs agree"), std::string::npos) << mixed.out;
  EXPECT_FALSE(fs::exists(own.path("out/knocked.yaml")));
}

TEST_F(Stereo, BadInputIsSaid) {
  const Folder own;
  const std::string chain = own.write("chain.yaml", camchain());
  EXPECT_NE(run({"stereo", "--help"}).out.find("Examples:"), std::string::npos);
  EXPECT_EQ(run({"stereo"}).code, 2);
  EXPECT_EQ(run({"stereo", own.path("none"), "--calibration", chain}).code, 4);
  EXPECT_EQ(run({"stereo", own.path("none"), "--calibration", own.path("none.yaml")}).code, 4);
  own.write("empty.jsonl", "\n");
  EXPECT_EQ(run({"stereo", own.path("empty.jsonl"), "--calibration", chain}).code, 3);
  own.write("bad.jsonl", "{\"left\": \"a.png\", \"rigth\": \"b.png\"}\n");
  const Finished key = run({"stereo", own.path("bad.jsonl"), "--calibration", chain});
  EXPECT_EQ(key.code, 3);
  EXPECT_NE(key.err.find("bad.jsonl:1"), std::string::npos) << key.err;
  EXPECT_NE(key.err.find("rigth"), std::string::npos) << key.err;
  // Calibrations with something missing, cut off, not finite, no rotation, without baseline.
  const auto broken = [&](const std::string& from, const std::string& to) {
    std::string text = camchain();
    text.replace(text.find(from), from.size(), to);
    own.write("broken.yaml", text);
    expect_error([&] { load_stereo(own.path("broken.yaml")); }, ErrorCode::invalid_argument, {"broken.yaml"});
  };
  broken("T_cn_cnm1", "T_other");
  broken("cam1:", "camera:");
  broken("  - [1.0, 0.0, 0.0, -1.2]\n", "");
  broken("[1.0, 0.0, 0.0, -1.2]", "[nan, 0.0, 0.0, -1.2]");
  broken("[1.0, 0.0, 0.0, -1.2]", "[3.0, 0.0, 0.0, -1.2]");
  broken("-1.2]\n  - [0.0, 1.0, 0.0, 0.01]", "0]\n  - [0.0, 1.0, 0.0, 0]");
  own.write("cut.yaml", camchain().substr(0, 300));
  expect_error([&] { load_stereo(own.path("cut.yaml")); }, ErrorCode::invalid_argument, {"cut.yaml"});
  // One pair without depth, then blank ones.
  cv::imwrite(own.path("l.png"), cv::Mat(240, 320, CV_8UC1, cv::Scalar(90)));
  cv::imwrite(own.path("r.png"), cv::Mat(236, 328, CV_8UC1, cv::Scalar(90)));
  own.write("one.jsonl", "{\"left\": \"l.png\", \"right\": \"r.png\"}\n");
  const Finished depth = run({"stereo", own.path("one.jsonl"), "--calibration", chain});
  EXPECT_EQ(depth.code, 3);
  EXPECT_NE(depth.err.find("--distance"), std::string::npos) << depth.err;
  const Finished blank = run({"stereo", own.path("one.jsonl"), "--calibration", chain, "--distance", "5", "--solver", "cpu",
                              "--out", own.path("blank")});
  EXPECT_EQ(blank.code, 14) << blank.err << blank.out;
  EXPECT_FALSE(nlohmann::json::parse(bytes_of(own.path("blank/result.json"))).at("usable"));
  EXPECT_FALSE(fs::exists(own.path("blank/chain.yaml")));
}

}  // namespace
}  // namespace iclk::test
