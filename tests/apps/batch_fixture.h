#pragma once
#include <algorithm>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/sets/scene.h"
#include "batch_process.h"

namespace iclk::test {

using Results = std::map<std::string, Json>;

/// Scenes in files, made once, and manifests over them.
class Batch : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new Folder;
    std::filesystem::create_directories(folder_->path("images"));
    make_scene("a", 160, 120, {0.02, -0.01, 0.02, 0.01, 0.015, -0.02});
    make_scene("b", 160, 120, {-0.02, 0.015, 0.01, -0.01, 0.005, 0.01});
    make_scene("wide", 208, 120, {0.01, 0.02, -0.02, 0.005, -0.01, 0.015});
    cv::Mat grey;
    cv::cvtColor(cv::imread(folder_->path("images/a_1.png")), grey, cv::COLOR_BGR2GRAY);
    cv::imwrite(folder_->path("images/grey_1.png"), grey);
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }

  static void make_scene(const std::string& name, int width, int height, const std::array<double, 6>& twist) {
    SceneOptions options;
    options.width = width;
    options.height = height;
    const ScenePair scene = make_scene_pair(SE3::exp(Vector6d(twist.data())), options);
    const std::string stem = folder_->path("images/" + name);
    cv::imwrite(stem + "_0.png", scene.image_0);
    cv::imwrite(stem + "_1.png", scene.image_1);
    cv::Mat depth;
    scene.depth_0.convertTo(depth, CV_16U, 5000);
    cv::imwrite(stem + "_d.png", depth);
    const Camera& c = scene.camera;
    folder_->write("images/" + name + ".txt", std::to_string(c.fx) + " " + std::to_string(c.fy) + " " + std::to_string(c.cx) +
                                                  " " + std::to_string(c.cy) + " " + std::to_string(width) + " " +
                                                  std::to_string(height) + " 5000\n");
    folder_->write("images/" + name + "_truth.txt", tum_line(scene.T_10));
  }

  static Json line(const std::string& id, const std::string& scene) {
    return {{"id", id},
            {"reference", "images/" + scene + "_0.png"},
            {"target", "images/" + scene + "_1.png"},
            {"depth", "images/" + scene + "_d.png"},
            {"camera", "images/" + scene + ".txt"},
            {"truth", "images/" + scene + "_truth.txt"}};
  }
  /// Pairs that all give different bits: each starts elsewhere.
  static std::vector<std::string> lines(int count, const std::string& prefix = "p") {
    std::vector<std::string> all;
    for (int i = 0; i < count; ++i) {
      Json json = line(prefix + std::to_string(i),
                       std::vector<std::string>{"a", "b", "wide"}[static_cast<size_t>(i % 5 == 3 ? 2 : i % 2)]);
      if (i % 7 == 4)
        json["target"] = "images/grey_1.png", json["reference"] = "images/a_0.png", json["depth"] = "images/a_d.png",
        json["camera"] = "images/a.txt", json["truth"] = "images/a_truth.txt";
      json["initial_pose"] = std::to_string(1e-5 * i) + " 0 0 0 0 0 1";
      all.push_back(json.dump());
    }
    return all;
  }
  static std::string manifest(const std::string& name, const std::vector<std::string>& lines) {
    std::string text;
    for (const std::string& line : lines) text += line + "\n";
    return folder_->write(name, text);
  }
  static std::vector<std::string> batch(const std::string& manifest, const std::string& out,
                                        std::vector<std::string> more = {}) {
    std::vector<std::string> all = {"batch", manifest, "--out", out};
    if (std::find(more.begin(), more.end(), "--solver") == more.end()) all.insert(all.end(), {"--solver", "cpu"});
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  /// Runs to the end and returns the results.
  static Results run(const std::string& manifest, const std::string& out, std::vector<std::string> more = {}, int code = 0) {
    Process process(batch(manifest, out, std::move(more)));
    EXPECT_EQ(process.wait(), code) << process.err();
    return results_of(out);
  }
  /// Must end with `code`, say all the pieces and leave `out` as it was.
  static void expect_refused(const std::vector<std::string>& arguments, int code, std::initializer_list<std::string> pieces) {
    const std::string out = arguments[3], before = std::filesystem::is_regular_file(out) ? bytes_of(out) : "";
    Process process(arguments);
    EXPECT_EQ(process.wait(), code) << process.err();
    for (const std::string& piece : pieces)
      EXPECT_NE(process.err().find(piece), std::string::npos) << "'" << piece << "' in: " << process.err();
    EXPECT_EQ(std::filesystem::is_regular_file(out) ? bytes_of(out) : "", before);
  }

  static inline Folder* folder_ = nullptr;
};

}  // namespace iclk::test
