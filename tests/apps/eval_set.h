#pragma once
#include <string>

#include <opencv2/imgcodecs.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/sets/scene.h"
#include "files.h"

namespace iclk::test {

/// A set of three pairs of 256x192 with truth, as `iclk render` lays them out: set/pairs.jsonl, images/, depth/.
class EvalSet {
 public:
  static constexpr int kPairs = 3;

  EvalSet() {
    std::string lines;
    for (int i = 0; i < kPairs; ++i) {
      Vector6d xi;
      xi << 0.02 * i, -0.01, 0.01 * i, 0.01, -0.008 * i, 0.012;
      const ScenePair pair = make_scene_pair(SE3::exp(xi), {256, 192, static_cast<uint64_t>(i) + 1, 1, 0, 1});
      const std::string id = "p" + std::to_string(i);
      folder_.write("set/images/" + id + "_0.png", "");
      cv::imwrite(folder_.path("set/images/" + id + "_0.png"), pair.image_0);
      cv::imwrite(folder_.path("set/images/" + id + "_1.png"), pair.image_1);
      cv::imwrite(folder_.path("set/images/" + id + "_z0.tiff"), pair.depth_0);
      cv::imwrite(folder_.path("set/images/" + id + "_z1.tiff"), pair.depth_1);
      const Camera& c = pair.camera;
      lines += "{\"id\": \"" + id + "\", \"reference\": \"images/" + id + "_0.png\", \"target\": \"images/" + id +
               "_1.png\", \"depth\": \"images/" + id + "_z0.tiff\", \"camera\": [" + std::to_string(c.fx) + ", " +
               std::to_string(c.fy) + ", " + std::to_string(c.cx) + ", " + std::to_string(c.cy) + "], \"truth\": \"" +
               tum_line(pair.T_10) + "\", \"meta\": {\"target_depth\": \"images/" + id + "_z1.tiff\"}}\n";
    }
    lines_ = lines;
    folder_.write("set/pairs.jsonl", lines);
  }
  std::string path() const { return folder_.path("set"); }
  const std::string& lines() const { return lines_; }
  const Folder& folder() const { return folder_; }
  /// A manifest beside the others, with `text` for its lines.
  std::string manifest(const std::string& name, const std::string& text) const { return folder_.write("set/" + name, text); }

 private:
  Folder folder_;
  std::string lines_;
};

}  // namespace iclk::test
