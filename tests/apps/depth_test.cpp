// iclk depth as a user runs it.
#include <cmath>
#include <filesystem>

#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/depth/input.h"
#include "apps/iclk/io/undistorter.h"
#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

namespace fs = std::filesystem;

/// Uses the fixture's pair, whose motion is small: a depth map all the same, and files that others can read.
using DepthCommand = Command;

std::vector<std::string> depth(const std::vector<std::string>& more) {
  std::vector<std::string> all = {"depth"};
  all.insert(all.end(), more.begin(), more.end());
  return all;
}

TEST_F(DepthCommand, WritesWhatItSays) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string out = folder.path("out");
  const Finished f = run(depth({file("a.png"), file("b.png"), "--camera", camera_, "--pose", truth_, "--depth", file("d.exr"),
                                "--truth", file("d.exr"), "--out", out, "--json"}));
  ASSERT_EQ(f.code, 0) << f.err;
  const auto json = nlohmann::json::parse(f.out);
  EXPECT_LT(json.at("truth").at("bad_2_of_answers").get<double>(), 0.02) << f.out;
  EXPECT_GT(json.at("truth").at("completeness").get<double>(), 0.8) << f.out;
  const cv::Mat metres = cv::imread(out + "/depth.tiff", cv::IMREAD_UNCHANGED),
                raw = cv::imread(out + "/depth.png", cv::IMREAD_UNCHANGED);
  ASSERT_EQ(metres.type(), CV_32FC1);
  ASSERT_EQ(raw.type(), CV_16UC1);
  const double scale = json.at("png_scale").get<double>();
  for (int v = 0; v < metres.rows; v += 7)
    for (int u = 0; u < metres.cols; u += 7)
      ASSERT_NEAR(static_cast<double>(metres.at<float>(v, u)), raw.at<uint16_t>(v, u) / scale, 0.51 / scale);
  EXPECT_FALSE(cv::imread(out + "/colour.png").empty());
  EXPECT_EQ(cv::imread(out + "/confidence.png", cv::IMREAD_UNCHANGED).type(), CV_8UC1);
  const std::string cloud = bytes_of(out + "/cloud.ply");
  const std::string count = "element vertex " + std::to_string(cv::countNonZero(metres)) + "\n";
  EXPECT_NE(cloud.find(count), std::string::npos);
  EXPECT_EQ(cloud.size() - cloud.find("end_header\n") - 11, 15u * static_cast<size_t>(cv::countNonZero(metres)));
  const Finished filled = run(depth(
      {file("a.png"), file("b.png"), "--camera", camera_, "--pose", truth_, "--depth", file("d.exr"), "--fill", "--json"}));
  const auto whole = nlohmann::json::parse(filled.out);
  EXPECT_GT(whole.at("valid").get<double>(), 0.8);
}

TEST_F(DepthCommand, TheExitCodeSaysWhatTheMapIsWorth) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const auto run_with = [&](const std::string& pose, const std::vector<std::string>& more) {
    std::vector<std::string> all = {file("a.png"), file("b.png"), "--camera", camera_, "--pose", pose, "--json"};
    all.insert(all.end(), more.begin(), more.end());
    return run(depth(all));
  };
  const auto said = [](const Finished& f) { return nlohmann::json::parse(f.out).at("status").get<std::string>(); };
  const Finished right = run_with(truth_, {"--depth", file("d.exr")});
  EXPECT_EQ(right.code, 0) << right.out;
  EXPECT_EQ(said(right), "converged");
  EXPECT_GT(nlohmann::json::parse(right.out).at("agreeing").get<double>(), 0.9);
  const Finished wrong = run_with("1 0 0 0 0 1 0", {"--depth", file("d.exr")});
  EXPECT_EQ(wrong.code, 12) << wrong.out;
  EXPECT_EQ(said(wrong), "degenerate");
  cv::Mat far;
  cv::imread(file("d.exr"), cv::IMREAD_UNCHANGED).convertTo(far, CV_32F, 2);
  cv::imwrite(folder.path("far.tiff"), far);
  const std::string range = "0.5," + std::to_string(10 * cv::mean(far)[0]);
  const Finished contradicted = run_with(truth_, {"--depth", folder.path("far.tiff"), "--depth-range", range});
  EXPECT_EQ(contradicted.code, 14) << contradicted.out;
  const std::string lost =
      folder.write("lost.json", R"({"status": "diverged", "T_10": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]})");
  const Finished refused =
      run(depth({file("a.png"), file("b.png"), "--camera", camera_, "--result", lost, "--depth-range", "1,9"}));
  EXPECT_EQ(refused.code, 3);
  EXPECT_NE(refused.err.find("diverged"), std::string::npos) << refused.err;
}

TEST_F(DepthCommand, ADepthImageIsUndistortedAsItsImage) {
  DepthFiles files;
  files.reference = file("a.png"), files.targets = {file("b.png")}, files.poses = {truth_}, files.camera = camera_;
  files.depth = file("d.exr"), files.distortion = "radtan:-0.2,0.05,0,0";
  const DepthInput input = load_depth_input(files);
  const cv::Mat depth = cv::imread(files.depth, cv::IMREAD_UNCHANGED);
  ASSERT_GT(input.measured.size(), 1000);
  int moved = 0;
  for (size_t i = 0; i < input.measured.uv.size(); i += 17) {
    const Eigen::Vector2d there = input.lens->source(input.measured.uv[i]);
    const float z = depth.at<float>(cvRound(there.y()), cvRound(there.x()));
    EXPECT_NEAR(1 / input.measured.inverse_depth[i], z, 1e-3 * z) << there.transpose();
    moved += (there - input.measured.uv[i]).norm() > 1;
  }
  EXPECT_GT(moved, 20);
}

TEST_F(DepthCommand, BadInputIsSaid) {
  const Folder folder;
  EXPECT_NE(run({"depth", "--help"}).out.find("Examples:"), std::string::npos);
  EXPECT_EQ(run({"depth"}).code, 2);
  const auto refused = [&](std::vector<std::string> more, int code, const std::string& word) {
    more.insert(more.begin(), {file("a.png"), file("b.png"), "--camera", camera_});
    const Finished f = run(depth(more));
    EXPECT_EQ(f.code, code) << word << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << f.err;
  };
  refused({"--depth-range", "1,9"}, 3, "--pose");
  refused({"--pose", truth_}, 3, "--depth-range");
  refused({"--pose", truth_, "--depth-range", "9,1"}, 3, "near must be above 0");
  refused({"--pose", truth_, "--depth-range", "one"}, 3, "NEAR,FAR");
  refused({"--pose", "0 0 0 0 0 0 1", "--depth-range", "1,9"}, 3, "baseline");
  refused({"--pose", truth_, "--depth-range", "1,9", "--planes", "7"}, 3, "planes");
  refused({"--pose", truth_, "--depth-range", "1,9", "--set", "p2=400"}, 3, "p2");
  refused({"--pose", truth_, "--depth-range", "1,9", "--memory", "-1"}, 3, "--memory");
  refused({"--pose", truth_, "--depth-range", "1,9", "--memory", "2"}, 3, "2000000");
  cv::imwrite(folder.path("small.tiff"), cv::Mat(20, 30, CV_32F, cv::Scalar(2)));
  refused({"--pose", truth_, "--depth", folder.path("small.tiff")}, 3, "30x20");
  refused({"--result", folder.path("none.json"), "--depth-range", "1,9"}, 4, "none.json");
  refused({"--result", folder.write("broken.json", "{]"), "--depth-range", "1,9"}, 3, "broken.json");
}

/// Middlebury's own numbers; the truth comes as an image of metres if somebody has made one of motorcycle_disp.npz.
TEST(Depth, BetterThanSgbmOnMotorcycle) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("middlebury_motorcycle");
  if (data.empty()) GTEST_SKIP() << test::no_data("middlebury_motorcycle");
  const Folder folder;
  const std::string truth = folder.path("truth.tiff");
  const std::string script = "import numpy as n,cv2; d=n.load('" + data +
                             "/motorcycle_disp.npz')['arr_0'].astype('f8'); "
                             "g=n.isfinite(d)&(d>0); z=n.zeros(d.shape,'f4'); z[g]=0.193001*994.978/(d[g]+31.086); "
                             "cv2.imwrite('" +
                             truth + "',z)";
  if (std::system(("/usr/bin/python3 -c \"" + script + "\" 2>/dev/null").c_str()) != 0 || !fs::exists(truth))
    GTEST_SKIP() << "no python3 with numpy and cv2 to read motorcycle_disp.npz";
  const std::vector<std::string> pair = {"depth",
                                         data + "/motorcycle_left.png",
                                         data + "/motorcycle_right.png",
                                         "--camera",
                                         "994.978,994.978,311.193,254.877",
                                         "--target-camera",
                                         "994.978,994.978,342.279,254.877",
                                         "--pose",
                                         "-0.193001 0 0 0 0 0 1",
                                         "--depth-range",
                                         "2,6",
                                         "--truth",
                                         truth,
                                         "--json"};
  const auto with = [&](const char* option) {
    std::vector<std::string> all = pair;
    all.push_back(option);
    return run(all);
  };
  if (!has_program("iclk-peers")) GTEST_SKIP() << "no iclk-peers";
  const Finished f = with("--peers"), unseen = with("--keep-unseen");
  ASSERT_EQ(f.code, 0) << f.err;
  const auto json = nlohmann::json::parse(f.out);
  const auto ours = json.at("truth");
  EXPECT_LT(ours.at("bad_2").get<double>(), 0.14);
  EXPECT_LT(ours.at("bad_2_of_answers").get<double>(), 0.052);
  EXPECT_LT(ours.at("median_relative_error").get<double>(), 0.0019);
  EXPECT_GT(ours.at("completeness").get<double>(), 0.89);
  ASSERT_EQ(unseen.code, 0) << unseen.err;
  const auto kept = nlohmann::json::parse(unseen.out).at("truth");
  EXPECT_LT(kept.at("bad_2").get<double>(), 0.118);
  EXPECT_LT(kept.at("bad_2_of_answers").get<double>(), 0.052);
  ASSERT_GE(json.at("peers").size(), 6u);
  for (const auto& peer : json.at("peers")) {
    const std::string name = peer.at("name");
    EXPECT_LT(ours.at("bad_2_of_answers"), peer.at("truth").at("bad_2_of_answers")) << name;
    const bool widened = name.find("widened") != std::string::npos;  // which answers where the other image does not reach
    EXPECT_LT((widened ? kept : ours).at("bad_2"), peer.at("truth").at("bad_2")) << name;
  }
}

}  // namespace
}  // namespace iclk::test
