// `iclk render --pose` and `--pairs`, of one camera and of a rig.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <opencv2/core.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/common/progress.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/sets/pair_set.h"
#include "apps/iclk/sets/render_loop.h"
#include "apps/iclk/sets/render_options.h"
#include "apps/json/format.h"
#include "apps/json/json.h"
#include "apps/json/manifest.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

std::string size_of(const Camera& camera) { return fmt::format("{}x{}", camera.width, camera.height); }

/// CV_8UC1, 0 where a feature's place in the undistorted image is too near to its border; empty without a lens.
cv::Mat suitable(const LensCamera& eye, int border) {
  if (eye.lens.empty()) return {};
  const Camera& c = eye.camera;
  cv::Mat mask = cv::Mat::zeros(c.height, c.width, CV_8UC1);
  for (int v = 0; v < c.height; ++v)
    for (int u = 0; u < c.width; ++u) {
      const auto at = pinhole_pixel(c, eye.lens, {u, v});
      if (at && at->minCoeff() >= border && at->x() <= c.width - 1 - border && at->y() <= c.height - 1 - border)
        mask.at<uchar>(v, u) = 255;
    }
  return mask;
}

Features choose_features(const View& view, const cv::Mat& suits, DetectorOptions options, uint64_t index) {
  options.seed = options.seed * 0x9E3779B97F4A7C15u + index;
  return detect_features(view.image(), view.depth_image(), iclk::view(suits), options);
}

/// Means of what was drawn, over the whole set.
std::string statistics(const PairSet& set) {
  struct Series {
    const char* name;
    const char* unit;
    double sum = 0, least = INFINITY, greatest = -INFINITY;
    size_t count = 0;
  } all[] = {{"e_pixel", "px"}, {"e_transl", "m"}, {"e_rot", "rad"}, {"altitude", "m"}};
  for (const auto& [index, line] : set.lines()) {
    const Json& meta = line["meta"];
    const Json start = meta.value("start", Json::object());
    for (Series& s : all) {
      const double x = s.name == std::string("altitude") ? meta.value(s.name, NAN) : start.value(s.name, NAN);
      if (std::isnan(x)) continue;
      s.sum += x, s.least = std::min(s.least, x), s.greatest = std::max(s.greatest, x);
      ++s.count;
    }
  }
  std::string text = "means of the set (least to greatest); the errors are those of a start without motion:\n";
  for (const Series& s : all) {
    if (s.count == 0) continue;
    text += formatted("  %-9s %9.4g %-3s (%.4g to %.4g)\n", s.name, s.sum / static_cast<double>(s.count), s.unit, s.least,
                      s.greatest);
  }
  return text;
}

/// How much of a view is ground.
std::string seen_text(const View& view) {
  float nearest = 0, farthest = 0;
  size_t seen = 0;
  for (const float z : view.depth) {
    if (!(z > 0)) continue;
    nearest = seen == 0 ? z : std::min(nearest, z), farthest = std::max(farthest, z);
    ++seen;
  }
  return fmt::format("{:.1f} % of the pixels see ground, {:.2f} to {:.2f} m deep",
                     100.0 * static_cast<double>(seen) / static_cast<double>(view.depth.size()), nearest, farthest);
}

}  // namespace

std::string render_view(const RenderCommand& command, TerrainRenderer& renderer, const RenderedCameras& cameras) {
  const SE3 T_WC = load_pose(command.pose, "--pose");
  const LensCamera& left = cameras.left;
  const View view = renderer.render(left.camera, T_WC, left.lens);
  make_output_folder(command.out);
  Json json = {{"camera", camera_json(left.camera)}, {"T_WC", tum_line(T_WC)}};
  if (!left.lens.empty()) json["distortion"] = distortion_text(left.lens.distortion());
  if (std::all_of(view.depth.begin(), view.depth.end(), [](float z) { return z == 0; }))
    spdlog::warn("the view shows no ground: the map is {}, the camera is at {}", renderer.terrain().extent().text(),
                 tum_line(T_WC));
  if (!cameras.rig) {
    write_file(command.out + "/view.png", encode_view(view));
    write_file(command.out + "/depth.tiff", encode_depth(view));
    write_file(command.out + "/view.json", json.dump(2) + "\n");
    return seen_text(view) + "; view.png and depth.tiff in " + command.out + "\n";
  }
  const RenderedRig& rig = *cameras.rig;
  const View right = renderer.render(rig.right.camera, T_WC * rig.T_rl.inverse(), rig.right.lens);
  json["right_camera"] = camera_json(rig.right.camera);
  json["right_distortion"] = distortion_text(rig.right.lens.distortion());
  json["T_rl"] = pose_json(rig.T_rl);
  for (const char* name : {"left", "right", "depth"}) make_output_folder(command.out + "/" + name);
  write_file(command.out + "/left/view.png", encode_view(view));
  write_file(command.out + "/right/view.png", encode_view(right));
  write_file(command.out + "/depth/view.tiff", encode_depth(view));
  write_calibrations(command, rig);
  write_file(command.out + "/view.json", json.dump(2) + "\n");
  return "left: " + seen_text(view) + "; right: " + seen_text(right) + "; in " + command.out + "\n";
}

std::string render_pairs(const RenderCommand& command, TerrainRenderer& renderer, TerrainRenderer* target,
                         const RenderedCameras& cameras, const std::string& device) {
  const PairOptions options = pair_options(command, cameras);
  const Shard shard = parse_shard(command.shard);
  PairSource source(renderer, options, target);
  DetectorOptions detector = command.features;
  detector.detector = parse_detector(command.detector);
  detector.seed = command.pair.seed;
  detector.check();
  const bool rig = cameras.rig.has_value();
  const Terrain& terrain = renderer.terrain();
  PairSet set(command.out, rig ? SetLayout::rig : SetLayout::pairs,
              set_options(command, options, cameras, terrain, target ? &target->terrain() : nullptr),
              about(command, terrain, device));
  if (rig) write_calibrations(command, *cameras.rig);
  std::vector<uint64_t> todo;
  uint64_t total = 0;
  for (auto i = static_cast<uint64_t>(shard.k); i < static_cast<uint64_t>(command.pairs); i += static_cast<uint64_t>(shard.n)) {
    ++total;
    if (!set.has(i)) todo.push_back(i);
  }
  const Camera &first = cameras.left.camera, &second = rig ? cameras.rig->right.camera : first;
  const std::string size = size_of(first) + (size_of(first) == size_of(second) ? "" : " and " + size_of(second));
  check_disk(command.out, "pairs of " + size, todo.size(),
             largest_pair(first, second, rig ? 0 : detector.count, command.target_depth ? 2 : 1),
             "fewer --pairs (a set can be continued)");
  const cv::Mat suits = rig ? cv::Mat() : suitable(cameras.left, std::max(detector.border, 0));
  const double seconds = render_each("pairs", todo, total, [&](uint64_t index) -> std::function<void()> {
    auto pair = std::make_shared<const RenderedPair>(source.draw(index));
    return [&, pair, index] {
      if (rig)
        set.add(index, rig_entry(index, *pair));
      else
        set.add(index, pair_entry(index, *pair, first, cameras.left.lens, choose_features(pair->view0, suits, detector, index),
                                  command.target_depth));
    };
  });
  if (!todo.empty()) spdlog::info("{}", source.rejected().text());
  set.sort();
  return fmt::format("{} pairs of {} in {}; {} rendered in {}\n", set.size(), size, set.manifest(), todo.size(),
                     duration_text(seconds)) +
         statistics(set);
}

}  // namespace iclk
