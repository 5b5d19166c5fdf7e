// iclk track with features in files instead of depth images.
#include <filesystem>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "apps/iclk/io/images.h"
#include "apps/iclk/io/sequence.h"
#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

namespace fs = std::filesystem;

constexpr int kFeatureFrames = 16;

/// The corners of an image and their depths, as a feature file.
std::string corners_csv(const SequenceFrame& frame, bool along_ray, const Camera& camera) {
  const cv::Mat image = cv::imread(frame.image, cv::IMREAD_GRAYSCALE), depth = load_depth(frame.depth, 1000);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 188, 0.005, 9);
  std::string csv = "u,v,depth,sigma\n";
  for (const cv::Point2f& p : corners) {
    const double z = depth.at<float>(static_cast<int>(p.y), static_cast<int>(p.x));
    csv += fmt::format("{},{},{},{}\n", p.x, p.y, along_ray ? z * camera.ray({p.x, p.y}).norm() : z, 0.001 * z * z);
  }
  return csv;
}

/// A recording without depth, and features of its frames.
class TrackFeatures : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::string data = data_folder("tartan_60");
    if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
    sequence_ = load_sequence(data);
    std::string list;
    for (int i = 0; i < kFeatureFrames; ++i) {
      const SequenceFrame& f = sequence_.frames[static_cast<size_t>(i)];
      fs::create_directories(folder_.path("recording/rgb"));
      const fs::path image(f.image);
      fs::copy_file(image, folder_.path("recording/rgb/" + image.filename().string()));
      list += fmt::format("{} rgb/{}\n", f.stamp, image.filename().string());
    }
    folder_.write("recording/rgb.txt", list);
    for (const char* name : {"camera.txt", "groundtruth.txt"})
      folder_.write(std::string("recording/") + name, bytes_of(data + "/" + name));
  }
  std::string write_features(const std::string& name, bool by_name, bool along_ray = false) const {
    fs::create_directories(folder_.path(name));
    for (int i = 0; i < kFeatureFrames; ++i) {
      const SequenceFrame& f = sequence_.frames[static_cast<size_t>(i)];
      const std::string stem = by_name ? fs::path(f.image).stem().string() : std::to_string(i);
      folder_.write(name + "/" + stem + ".csv", corners_csv(f, along_ray, {320, 320, 320, 240, 640, 480}));
    }
    return folder_.path(name);
  }
  Finished track(const std::string& features, std::vector<std::string> more = {}) const {
    std::vector<std::string> all = {"track", folder_.path("recording"), "--features", features, "--fresh",
                                    "--out", folder_.path("out")};
    all.insert(all.end(), more.begin(), more.end());
    return run(all);
  }
  std::string trajectory() const { return bytes_of(folder_.path("out/trajectory.txt")); }

  Folder folder_;
  Sequence sequence_;
};

TEST_F(TrackFeatures, NoDepthImageIsNeeded) {
  ICLK_NEED_DEVICE();
  EXPECT_EQ(run({"track", folder_.path("recording")}).code, 4);  // without them it is
  const std::string named = write_features("named", true);
  const Finished f = track(named);
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("16 tracked, 0 of them not confirmed"), std::string::npos) << f.out;
  EXPECT_LT(std::atof(f.out.substr(f.out.find("ATE ") + 4).c_str()), 1) << f.out;
  EXPECT_EQ(f.out.find("\ndepth "), std::string::npos) << f.out;
  const std::string by_name = trajectory();
  ASSERT_EQ(track(write_features("ordered", false)).code, 0);
  EXPECT_EQ(trajectory(), by_name);
  // Distances along the rays are the same points.
  const std::string along = write_features("along", true, true);
  const Finished rays = track(along, {"--depth-along-ray"});
  EXPECT_LT(std::atof(rays.out.substr(rays.out.find("ATE ") + 4).c_str()), 1) << rays.out;
}

TEST_F(TrackFeatures, FramesMayLackThem) {
  ICLK_NEED_DEVICE();
  const std::string features = write_features("features", true);
  const auto file = [&](int i) {
    return features + "/" + fs::path(sequence_.frames[static_cast<size_t>(i)].image).stem().string() + ".csv";
  };
  for (const int i : {1, 2, 3, 9}) fs::remove(file(i));
  folder_.write("features/" + fs::path(file(5)).filename().string(), "u,v,depth\n1,2\n");
  folder_.write("features/" + fs::path(file(6)).filename().string(), "u,v,depth\n");
  const Finished f = track(features);
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("16 tracked"), std::string::npos) << f.out;
  EXPECT_NE(f.out.find("depth      6 frames have none"), std::string::npos) << f.out;
  EXPECT_NE(f.out.find("unreadable 1, the first: " + file(5) + ":2: 2 cells"), std::string::npos) << f.out;
}

TEST_F(TrackFeatures, PositionsBelongToTheRecordedImage) {
  ICLK_NEED_DEVICE();
  // The images are taken as those of a lens: their corners stay corners only if both are undistorted.
  const std::string features = write_features("features", true);
  const Finished f = track(features, {"--distortion", "radtan:0.1,0,0,0"});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("16 tracked, 0 of them not confirmed"), std::string::npos) << f.out;
}

TEST_F(TrackFeatures, WhatDoesNotFitIsSaid) {
  const std::string features = write_features("features", false);
  for (int i = 0; i < 3; ++i) folder_.write(fmt::format("features/more_{}.csv", i), "u,v,depth\n");
  const Finished many = track(features);
  EXPECT_EQ(many.code, 3);
  EXPECT_NE(many.err.find("19 feature files"), std::string::npos) << many.err;
  EXPECT_EQ(track(features, {"--depth", features}).code, 2);
  EXPECT_EQ(track(folder_.path("none")).code, 2);
}

}  // namespace
}  // namespace iclk::test
