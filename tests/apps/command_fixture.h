#pragma once
#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/sets/scene.h"
#include "files.h"

namespace iclk::test {

struct Finished {
  int code = -1;
  std::string out, err;
};

inline Finished run(
    const std::vector<std::string>& arguments, const std::function<void()>& before = [] {}) {
  const Folder folder;
  const std::string out = folder.path("out"), err = folder.path("err");
  const pid_t child = fork();
  if (child == 0) {
    dup2(open(out.c_str(), O_WRONLY | O_CREAT, 0600), 1);
    dup2(open(err.c_str(), O_WRONLY | O_CREAT, 0600), 2);
    setenv("ICLK_MODEL", "classical", 0);  // most tests are about other things; `before` may unset it
    before();
    std::vector<char*> argv = {const_cast<char*>("iclk")};
    for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
    argv.push_back(nullptr);
    execv(ICLK_COMMAND, argv.data());
    _exit(127);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status), bytes_of(out), bytes_of(err)};
}

/// Every line of a file is what a schema of docs/schema says; where no Python is that could tell, nothing is asked.
inline void expect_lines_of(const std::string& schema, const std::string& file) {
#ifdef ICLK_SCHEMA_PYTHON
  const Folder folder;
  const std::string command =
      fmt::format("'{}' -B '{}/tests/schema/lines.py' '{}/docs/schema/{}' '{}' >'{}' 2>&1", ICLK_SCHEMA_PYTHON, ICLK_SOURCE_DIR,
                  ICLK_SOURCE_DIR, schema, file, folder.path("said"));
  EXPECT_EQ(std::system(command.c_str()), 0) << bytes_of(folder.path("said"));
#else
  (void)schema, (void)file;
#endif
}

/// A pair in files, made once.
class Command : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new Folder;
    SceneOptions options;
    options.width = 320;
    options.height = 240;
    Vector6d xi;
    xi << 0.02, -0.01, 0.02, 0.01, 0.015, -0.02;
    const ScenePair scene = make_scene_pair(SE3::exp(xi), options);
    cv::imwrite(file("a.png"), scene.image_0);
    cv::imwrite(file("b.png"), scene.image_1);
    cv::Mat depth;
    scene.depth_0.convertTo(depth, CV_16U, 5000);
    cv::imwrite(file("d.png"), depth);
    cv::imwrite(file("d.exr"), scene.depth_0);
    truth_ = tum_line(scene.T_10);
    char camera[100];
    std::snprintf(camera, sizeof camera, "%.9g,%.9g,%.9g,%.9g", scene.camera.fx, scene.camera.fy, scene.camera.cx,
                  scene.camera.cy);
    camera_ = camera;
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }

  static std::string file(const std::string& name) { return folder_->path(name); }
  static std::vector<std::string> align(std::vector<std::string> more = {}) {
    std::vector<std::string> all = {"align", file("a.png"), file("b.png"), "--depth",  file("d.png"), "--depth-scale",
                                    "5000",  "--camera",    camera_,       "--solver", "cpu"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }

  static inline Folder* folder_ = nullptr;
  static inline std::string truth_, camera_;
};

}  // namespace iclk::test
