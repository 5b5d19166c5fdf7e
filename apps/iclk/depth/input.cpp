#include "apps/iclk/depth/input.h"

#include <cmath>
#include <memory>

#include <iclk/align/alignment.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

std::vector<SE3> poses_of_file(const std::string& path) {
  std::vector<SE3> poses;
  const std::string text = read_file(path);
  int number = 0;
  for (const std::string_view line : lines_of(text)) {
    ++number;
    if (!without_comment(line).empty()) poses.push_back(parse_pose(line, path + ":" + std::to_string(number)));
  }
  return poses;
}

/// Pose and features of a result of `iclk align`.
void read_result(const std::string& path, DepthInput& input) {
  std::string why;
  const auto json = parse_json(read_file(path), &why);
  if (json.is_discarded() || !json.is_object()) refuse(path + ": not a result of iclk align: " + why);
  const auto status = json.find("status");
  if (status != json.end() && *status != name(Status::converged) && *status != name(Status::max_iterations))
    refuse(path + ": its status is " + status->dump() + ", so its T_10 cannot be used; align the images first");
  const auto pose = json.find("T_10");
  if (pose == json.end()) refuse(path + ": has no T_10; give the result.json of iclk align");
  input.T_10.push_back(parse_pose(pose->dump(), path + ": T_10"));
  const auto features = json.find("features");
  if (features == json.end() || !features->is_array()) return;
  for (const auto& f : *features) {
    const auto value = [&](const char* key) {
      const auto at = f.find(key);
      return at != f.end() && at->is_number() ? at->get<double>() : NAN;
    };
    const Eigen::Vector2d uv(value("u0"), value("v0"));
    if (!uv.allFinite() || !(value("inverse_depth") > 0)) continue;
    input.priors.uv.push_back(uv);
    input.priors.inverse_depth.push_back(value("inverse_depth"));
  }
}

Features measured(const cv::Mat& depth) {
  Features out;
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u)
      if (const float z = depth.at<float>(v, u); z > 0) {
        out.uv.push_back({u, v});
        out.inverse_depth.push_back(1 / static_cast<double>(z));
      }
  return out;
}

DepthRange parse_range(const std::string& text) {
  const std::vector<double> ends = parse_numbers(text, "--depth-range NEAR,FAR");
  if (ends.size() != 2) refuse("--depth-range " + text + ": must be NEAR,FAR in metres, such as 2,40");
  const DepthRange range{ends[0], ends[1]};
  range.check();
  return range;
}

}  // namespace

DepthInput load_depth_input(const DepthFiles& files) {
  DepthInput input;
  CameraFile camera = load_camera(files.camera);
  CameraFile target_camera = files.target_camera.empty() ? camera : load_camera(files.target_camera);
  if (!files.distortion.empty()) camera.distortion = target_camera.distortion = parse_distortion(files.distortion);
  if (!files.result.empty()) read_result(files.result, input);
  if (!files.pose_file.empty())
    for (const SE3& T : poses_of_file(files.pose_file)) input.T_10.push_back(T);
  for (const std::string& pose : files.poses) input.T_10.push_back(load_pose(pose, "--pose"));
  if (input.T_10.size() != files.targets.size())
    refuse(std::to_string(files.targets.size()) + " targets and " + std::to_string(input.T_10.size()) +
           " poses; give --pose once per target, --poses with one line per target, or --result");
  if (!files.range.empty()) input.range = parse_range(files.range);

  input.reference = load_image(files.reference);
  input.camera = fit_camera(camera, input.reference.cols, input.reference.rows);
  const auto pinhole = [](const CameraFile& file, const Camera& c) {
    return file.distortion.empty() ? nullptr : std::make_shared<const Undistorter>(c, file.distortion);
  };
  input.lens = pinhole(camera, input.camera);
  std::vector<cv::Mat> images = {input.reference};
  for (const std::string& path : files.targets) images.push_back(load_image(path));
  const Levels levels(images);
  levels.apply(input.reference);
  if (input.lens) input.reference = input.lens->image(input.reference);
  for (size_t i = 0; i < files.targets.size(); ++i) {
    const std::string& path = files.targets[i];
    cv::Mat image = images[i + 1];
    levels.apply(image);
    require_size(image, path, input.reference, files.reference);
    input.cameras.push_back(fit_camera(target_camera, image.cols, image.rows));
    if (const auto u = pinhole(target_camera, input.cameras.back())) image = u->image(image);
    input.targets.push_back(image);
  }
  if (!files.features.empty()) {
    Features given = load_features(files.features);
    if (input.lens)
      for (Eigen::Vector2d& uv : given.uv) uv = input.lens->point(uv);
    if (files.depth_along_ray) along_axis(input.camera, given);
    for (size_t i = 0; i < given.uv.size(); ++i) {
      input.priors.uv.push_back(given.uv[i]);
      input.priors.inverse_depth.push_back(given.inverse_depth[i]);
    }
  }
  if (!files.depth.empty()) {
    cv::Mat depth = load_depth(files.depth, files.depth_scale > 0 ? files.depth_scale : camera.depth_scale);
    require_size(depth, files.depth, input.reference, files.reference);
    if (input.lens) depth = input.lens->depth(depth);
    if (files.depth_along_ray) along_axis(input.camera, depth);
    input.measured = measured(depth);
  }
  if (!files.range.empty()) return input;
  std::vector<double> known = input.priors.inverse_depth;
  known.insert(known.end(), input.measured.inverse_depth.begin(), input.measured.inverse_depth.end());
  if (known.empty())
    refuse(files.reference +
           ": the depth range is unknown; give --depth-range NEAR,FAR, or sparse "
           "depths with --features, --depth or --result");
  input.range = range_of(known);
  return input;
}

}  // namespace iclk
