#include "apps/iclk/track/output.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <iclk/engine/error.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/pictures/plot.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

bool has_pose(const TrackedFrame& f) { return f.result.status != TrackStatus::lost; }

}  // namespace

std::string tum_text(std::span<const TrackedFrame> frames) {
  std::string text = "# timestamp tx ty tz qx qy qz qw (camera to world)\n";
  for (const TrackedFrame& f : frames)
    if (has_pose(f)) text += fmt::format("{:.6f} {}\n", f.result.time, tum_line(f.T_WC));
  return text;
}

std::string maps_text(std::span<const TrackedFrame> frames) {
  std::string text = "# map timestamp tx ty tz qx qy qz qw (camera to the world of that map)\n";
  for (const TrackedFrame& f : frames)
    if (has_pose(f)) text += fmt::format("{} {:.6f} {}\n", f.map, f.result.time, tum_line(f.T_WC));
  return text;
}

std::string kitti_text(std::span<const TrackedFrame> frames) {
  std::string text;
  for (const TrackedFrame& f : frames) {
    if (!has_pose(f)) continue;
    for (int i = 0; i < 3; ++i)
      text += fmt::format("{}{:.9g} {:.9g} {:.9g} {:.9g}", i ? " " : "", f.T_WC.R(i, 0), f.T_WC.R(i, 1), f.T_WC.R(i, 2),
                          f.T_WC.t(i));
    text += "\n";
  }
  return text;
}

std::string frame_json(const TrackResult& r) {
  nlohmann::ordered_json line;
  line["schema"] = kFrameSchema;
  line["time"] = r.time;
  line["status"] = name(r.status);
  line["confirmed"] = r.confirmed;
  line["reason"] = r.reason;
  line["map"] = r.map;
  if (r.status != TrackStatus::lost) {
    line["keyframe"] = r.keyframe;
    line["T_WC"] = tum_line(r.T_WC);
    line["T_CK"] = tum_line(r.T_CK);
    line["covariance"] = matrix_json(r.covariance);
    if (r.origin)
      line["origin"] = {{"keyframe", r.origin->keyframe},
                        {"T_CK", tum_line(r.origin->T_CK)},
                        {"covariance", matrix_json(r.origin->covariance)}};
    line["features"] = r.features;
    line["visible"] = r.visible;
    line["inliers"] = r.inliers;
    line["sigma_px"] = r.sigma;
  }
  if (r.before) line["keyframe_before"] = {{"keyframe", r.before->keyframe}, {"time", r.before->time}};
  line["searched"] = r.searched;
  line["ms"] = {{"align", r.align_ms}, {"keyframe", r.keyframe_ms}, {"bundle", r.bundle_ms}};
  return line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";  // a file's name may be no UTF-8
}

TrackResult parse_frame_json(std::string_view text) {
  try {
    const auto line = nlohmann::json::parse(text);
    TrackResult r;
    r.time = line.at("time");
    const std::string status = line.at("status");
    for (const TrackStatus s : {TrackStatus::tracked, TrackStatus::keyframe})
      if (status == name(s)) r.status = s;
    r.confirmed = line.at("confirmed");
    r.reason = line.at("reason");
    r.map = line.at("map");
    r.searched = line.at("searched");
    r.align_ms = line.at("ms").at("align");
    r.keyframe_ms = line.at("ms").at("keyframe");
    r.bundle_ms = line.at("ms").at("bundle");
    if (const auto before = line.find("keyframe_before"); before != line.end())
      r.before = TrackResult::Before{before->at("keyframe"), before->at("time")};
    if (r.status == TrackStatus::lost) return r;
    r.keyframe = line.at("keyframe");
    r.T_WC = parse_pose(line.at("T_WC").get<std::string>(), "T_WC");
    r.T_CK = parse_pose(line.at("T_CK").get<std::string>(), "T_CK");
    r.features = line.at("features");
    r.visible = line.at("visible");
    r.inliers = line.at("inliers");
    r.sigma = line.at("sigma_px");
    return r;
  } catch (const nlohmann::json::exception& error) {
    throw Error(ErrorCode::invalid_argument, std::string("not a line of frames.jsonl: ") + error.what());
  }
}

std::string map_ply(const Tracker& tracker, int map) {
  std::string points;
  int count = 0;
  for (const MapPoint& p : tracker.map()) {
    if (p.map != map) continue;
    ++count;
    const int value = std::clamp(static_cast<int>(std::lround(255 * p.grey)), 0, 255);
    points += fmt::format("{:.6g} {:.6g} {:.6g} {} {} {}\n", p.X.x(), p.X.y(), p.X.z(), value, value, value);
  }
  return fmt::format(
             "ply\nformat ascii 1.0\ncomment iclk track\nelement vertex {}\nproperty float x\nproperty float y\n"
             "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
             count) +
         points;
}

std::string path_png(std::span<const TrackedFrame> frames, const std::vector<SE3>& keyframes, const TrackErrors* errors) {
  // Truth in the map's world, if it is known how that lies.
  const SE3 T_map_truth = errors ? errors->absolute.alignment.inverse() : SE3();
  std::vector<Eigen::Vector3d> estimate, truth;
  for (const TrackedFrame& f : frames) {
    if (has_pose(f)) estimate.push_back(f.T_WC.t);
    if (errors && f.truth) truth.push_back(T_map_truth * f.truth->t);
  }
  Eigen::Vector3d low = Eigen::Vector3d::Constant(INFINITY), high = -low;
  for (const auto* points : {&estimate, &truth})
    for (const Eigen::Vector3d& p : *points) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
  if (estimate.empty()) low = high = Eigen::Vector3d::Zero();
  int axes[3] = {0, 2, 1};
  std::stable_sort(axes, axes + 3, [&](int a, int b) { return (high - low)(a) > (high - low)(b); });
  const int a = std::min(axes[0], axes[1]), b = std::max(axes[0], axes[1]);
  const auto projected = [&](const std::vector<Eigen::Vector3d>& points) {
    std::vector<cv::Point2d> out;
    for (const Eigen::Vector3d& p : points) out.emplace_back(p(a), p(b));
    return out;
  };
  std::vector<Eigen::Vector3d> places;
  for (const SE3& T : keyframes) places.push_back(T.t);
  const char* const names[] = {"x [m]", "y [m]", "z [m]"};
  const double side = std::max({(high - low)(a), (high - low)(b), 1e-3}) * 1.1;
  const Eigen::Vector3d middle = (low + high) / 2;
  Plot plot{.title = "Path of the camera",
            .x_label = names[a],
            .y_label = names[b],
            .x0 = middle(a) - side / 2,
            .x1 = middle(a) + side / 2,
            .y0 = middle(b) - side / 2,
            .y1 = middle(b) + side / 2};
  if (!truth.empty()) plot.curves.push_back({.name = "truth", .points = projected(truth)});
  plot.curves.push_back({.name = "iclk", .points = projected(estimate)});
  plot.curves.push_back({.name = "keyframes", .points = projected(places), .marks = true, .line = false});
  if (errors) plot.note = fmt::format("ATE {:.1f} mm", 1000 * errors->absolute.rmse);
  return encode_png(draw_plots("iclk track", {plot}, 1));
}

}  // namespace iclk
