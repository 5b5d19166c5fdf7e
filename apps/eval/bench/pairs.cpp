#include "apps/eval/bench/pairs.h"

#include <cmath>

#include <opencv2/imgproc.hpp>

#include <iclk/align/model/safetensors.h>
#include <iclk/align/pyramid.h>
#include <iclk/session/detect.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/sets/scene.h"

namespace iclk {
namespace {

constexpr int kVariants = 8;  // pairs from one rendering

/// Motion k of a low-discrepancy series around demo_motion().
SE3 motion(int k) {
  Vector6d xi;
  const auto wave = [&](double ratio) { return 2 * std::fmod(0.5 + ratio * (k + 1), 1.0) - 1; };
  xi << 0.05 * wave(0.6180), 0.05 * wave(0.7549), 0.04 * wave(0.5698), 0.03 * wave(0.8192), 0.03 * wave(0.6711),
      0.04 * wave(0.5497);
  return SE3::exp(xi);
}

/// The same scene in a mirror: x -> -x, y -> -y.
void mirror(PeerPair& pair, bool x, bool y) {
  if (!x && !y) return;
  for (cv::Mat* image : {&pair.image_0, &pair.image_1, &pair.depth_0, &pair.depth_1}) {
    cv::Mat flipped;
    cv::flip(*image, flipped, x && y ? -1 : x ? 1 : 0);
    *image = flipped;
  }
  const Eigen::Vector3d s(x ? -1 : 1, y ? -1 : 1, 1);
  pair.T_10 = {s.asDiagonal() * pair.T_10.R * s.asDiagonal(), s.asDiagonal() * pair.T_10.t};
  if (x) pair.camera.cx = pair.camera.width - 1 - pair.camera.cx;
  if (y) pair.camera.cy = pair.camera.height - 1 - pair.camera.cy;
}

PeerPair variant(const ScenePair& scene, int index, int features) {
  const bool backwards = index & 4;
  PeerPair pair;
  pair.image_0 = (backwards ? scene.image_1 : scene.image_0).clone();
  pair.image_1 = (backwards ? scene.image_0 : scene.image_1).clone();
  pair.depth_0 = (backwards ? scene.depth_1 : scene.depth_0).clone();
  pair.depth_1 = (backwards ? scene.depth_0 : scene.depth_1).clone();
  pair.T_10 = backwards ? scene.T_10.inverse() : scene.T_10;
  pair.camera = scene.camera;
  mirror(pair, index & 1, index & 2);
  cv::cvtColor(pair.image_0, pair.grey_0, cv::COLOR_BGR2GRAY);
  cv::cvtColor(pair.image_1, pair.grey_1, cv::COLOR_BGR2GRAY);
  DetectorOptions detector;
  detector.count = features;
  pair.features = detect_features(view(pair.grey_0), view(pair.depth_0), {}, detector);
  return pair;
}

}  // namespace

std::vector<PeerPair> make_bench_pairs(const BenchImages& images, int count, const Progress& progress) {
  std::vector<PeerPair> pairs;
  for (int k = 0; static_cast<int>(pairs.size()) < count; ++k) {
    progress("drawing images", static_cast<int>(pairs.size()), count + 1);
    SceneOptions scene_options;
    scene_options.width = images.width;
    scene_options.height = images.height;
    scene_options.seed = static_cast<uint64_t>(k) + 1;
    const ScenePair scene = make_scene_pair(motion(k), scene_options);
    for (int v = 0; v < kVariants && static_cast<int>(pairs.size()) < count; ++v)
      pairs.push_back(variant(scene, v, images.features));
  }
  progress("", count + 1, count + 1);
  return pairs;
}

void write_pair(const std::string& path, const PeerPair& pair, bool colour, const SE3& T_10) {
  internal::Safetensors file;
  const auto add = [&](const char* name, std::vector<size_t> shape, std::vector<float> data) {
    file.tensors.push_back({name, std::move(shape), std::move(data)});
  };
  const auto size = std::vector<size_t>{static_cast<size_t>(pair.camera.height), static_cast<size_t>(pair.camera.width)};
  for (const bool second : {false, true}) {
    const cv::Mat& image = colour ? (second ? pair.image_1 : pair.image_0) : (second ? pair.grey_1 : pair.grey_0);
    std::vector<float> planes;
    for (const Map& plane : colour ? rgb_maps(view(image)) : std::vector{grey_map(view(image))})
      planes.insert(planes.end(), plane.data.begin(), plane.data.end());
    add(second ? "image1" : "image0", {1, colour ? size_t{3} : size_t{1}, size[0], size[1]}, std::move(planes));
  }
  std::vector<float> uv, q;
  for (int i = 0; i < pair.features.size(); ++i) {
    const auto at = static_cast<size_t>(i);
    uv.insert(uv.end(), {static_cast<float>(pair.features.uv[at].x()), static_cast<float>(pair.features.uv[at].y())});
    q.push_back(static_cast<float>(pair.features.inverse_depth[at]));
  }
  const size_t count = q.size();
  add("features", {1, count, 2}, std::move(uv));
  add("inverse_depth", {1, count}, std::move(q));
  const Camera& k = pair.camera;
  add("camera", {4}, {static_cast<float>(k.fx), static_cast<float>(k.fy), static_cast<float>(k.cx), static_cast<float>(k.cy)});
  for (const auto& [prefix, T] : {std::pair{"", T_10}, std::pair{"truth_", pair.T_10}}) {
    const Eigen::Matrix<float, 3, 3, Eigen::RowMajor> R = T.R.cast<float>();
    add((std::string(prefix) + "R").c_str(), {1, 3, 3}, {R.data(), R.data() + 9});
    const Eigen::Vector3f t = T.t.cast<float>();
    add((std::string(prefix) + "t").c_str(), {1, 3}, {t.data(), t.data() + 3});
  }
  const std::vector<uint8_t> bytes = internal::safetensors_bytes(file);
  write_file(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace iclk
