// iclk track on video files, made here as Motion JPEG in AVI, which every OpenCV reads and writes.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/io/video.h"

#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

namespace fs = std::filesystem;

constexpr int kVideoFrames = 16;
const Camera kCamera{280, 280, 159.5, 119.5, 320, 240};

SE3 pose(int i) {
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  const double a = 0.08 * i;
  return {down, Eigen::Vector3d(120 + 40 * std::cos(a), 120 + 40 * std::sin(a), 150 + 3 * std::sin(2 * a))};
}

/// A flight as a video at 20 frames a second, and depth images of its frames; made once.
class TrackVideo : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new Folder;
    if (!device()) return;
    TerrainRenderer renderer(device(), std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256})));
    cv::VideoWriter writer(video(), cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 20, cv::Size(320, 240));
    fs::create_directories(depths());
    for (int i = 0; i < kVideoFrames; ++i) {
      const View view = renderer.render(kCamera, pose(i));
      cv::Mat bgr;
      cv::cvtColor(cv::Mat(240, 320, CV_8UC4, const_cast<uint32_t*>(view.rgba.data())), bgr, cv::COLOR_RGBA2BGR);
      writer.write(bgr);
      cv::imwrite(fmt::format("{}/{}.tiff", depths(), i), cv::Mat(240, 320, CV_32FC1, const_cast<float*>(view.depth.data())));
    }
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static std::string video() { return folder_->path("flight.avi"); }
  static std::string depths() { return folder_->path("depths"); }
  static std::vector<std::string> command(const std::string& file, std::vector<std::string> more) {
    std::vector<std::string> all = {"track", file, "--camera", "280,280,159.5,119.5", "--depth-sigma", "rendered"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  /// m, of the last pose of a trajectory.
  static double error(const std::string& trajectory) {
    const auto poses = load_trajectory(trajectory);
    return (poses.back().T_wc.t - (pose(0).inverse() * pose(kVideoFrames - 1)).t).norm();
  }
  static inline Folder* folder_ = nullptr;
};

TEST_F(TrackVideo, WithDepthImagesAndWithTheFirstAlone) {
  ICLK_NEED_DEVICE();
  const Folder out;
  const Finished all = run(command(video(), {"--depth", depths(), "--out", out.path("all")}));
  ASSERT_EQ(all.code, 0) << all.err;
  EXPECT_NE(all.out.find("16 tracked"), std::string::npos) << all.out;
  EXPECT_LT(error(out.path("all/trajectory.txt")), 0.5);
  const auto poses = load_trajectory(out.path("all/trajectory.txt"));
  ASSERT_EQ(poses.size(), 16u);
  for (size_t i = 0; i < poses.size(); ++i) EXPECT_NEAR(poses[i].stamp, 0.05 * static_cast<double>(i), 1e-5);

  const Finished first = run(command(video(), {"--depth", depths() + "/0.tiff", "--out", out.path("first")}));
  ASSERT_EQ(first.code, 0) << first.err;
  EXPECT_NE(first.out.find("16 tracked"), std::string::npos) << first.out;
  EXPECT_LT(error(out.path("first/trajectory.txt")), 1);
  EXPECT_NE(first.out.find("depth      15 frames have none"), std::string::npos) << first.out;
  for (const char* name : {"all", "first"}) expect_lines_of("frame-1.json", out.path(std::string(name) + "/frames.jsonl"));
}

TEST_F(TrackVideo, FramesAreReadInAnyOrder) {
  ICLK_NEED_DEVICE();
  Video a(video()), b(video());
  ASSERT_EQ(a.size(), kVideoFrames);
  EXPECT_TRUE(a.problem().empty());
  std::vector<cv::Mat> images;
  for (int i = 0; i < kVideoFrames; ++i) images.push_back(a.read(i).clone());
  for (const int i : {7, 3, 4, 15, 0}) EXPECT_EQ(cv::norm(b.read(i), images[static_cast<size_t>(i)], cv::NORM_INF), 0) << i;
  EXPECT_GT(cv::norm(images[3], images[4], cv::NORM_INF), 10);
  EXPECT_THROW(b.read(kVideoFrames), Error);
}

TEST_F(TrackVideo, WhatIsNoVideoIsSaid) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const auto refused = [&](const std::string& file, std::vector<std::string> more, int code, const char* words) {
    const Finished f = run(command(file, std::move(more)));
    EXPECT_EQ(f.code, code) << f.err;
    EXPECT_NE(f.err.find(words), std::string::npos) << f.err;
  };
  refused(folder.write("empty.mp4", ""), {"--depth", depths()}, 4, "the file is empty");
  refused(folder.write("text.mp4", "no video\n"), {"--depth", depths()}, 4, "cannot be read as a video");
  const std::string bytes = bytes_of(video());
  refused(folder.write("head.avi", bytes.substr(0, 500)), {"--depth", depths()}, 4, "head.avi");
  refused(video(), {}, 3, "--depth");
  fs::create_directories(folder.path("none_at_all"));
  refused(video(), {"--depth", folder.path("none_at_all")}, 3, "0 depth images");
  for (int i = 0; i <= kVideoFrames; ++i) folder.write("many/" + std::to_string(i) + ".png", "");
  refused(video(), {"--depth", folder.path("many")}, 3, "17 depth images");
  const Finished camera = run({"track", video(), "--depth", depths()});
  EXPECT_EQ(camera.code, 4);
  EXPECT_NE(camera.err.find("--camera"), std::string::npos) << camera.err;
  EXPECT_EQ(run(command(video(), {"--depth", folder.path("none")})).code, 2);
  // One that was cut off is tracked as far as it goes, and that is said.
  const Finished cut =
      run(command(folder.write("cut.avi", bytes.substr(0, bytes.size() / 2)), {"--depth", depths() + "/0.tiff"}));
  if (cut.code == 0) {
    EXPECT_NE(cut.err.find("may be truncated"), std::string::npos) << cut.err;
    EXPECT_EQ(cut.out.find("frames     16"), std::string::npos) << cut.out;
  } else {
    EXPECT_EQ(cut.code, 4) << cut.err;
  }
}

/// examples/track_video.cpp, which drops frames that come too early for the machine.
TEST_F(TrackVideo, TheExampleAnswersTheFramesThatItTakes) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  fs::create_directories(folder.path("mm"));
  for (int i = 0; i < kVideoFrames; ++i) {
    cv::Mat mm;
    cv::imread(fmt::format("{}/{}.tiff", depths(), i), cv::IMREAD_UNCHANGED).convertTo(mm, CV_16U, 100);  // it takes cm for mm
    cv::imwrite(fmt::format("{}/{:02}.png", folder.path("mm"), i), mm);
  }
  const std::string out = folder.path("path.avi"), text = folder.path("text");
  const std::string line = fmt::format("ICLK_MODEL=classical {} '{}' '{}' 280 280 159.5 119.5 '{}' > '{}'", ICLK_EXAMPLE_VIDEO,
                                       video(), folder.path("mm"), out, text);
  ASSERT_EQ(std::system(line.c_str()), 0);
  int frames = 0, dropped = 0, posed = 0;
  ASSERT_EQ(std::sscanf(bytes_of(text).c_str(), "%d frames, %d dropped, %d with a pose", &frames, &dropped, &posed), 3);
  EXPECT_EQ(frames, kVideoFrames);
  EXPECT_EQ(Video(out).size(), frames - dropped);
  EXPECT_GE(posed, 1);
}

}  // namespace
}  // namespace iclk::test
