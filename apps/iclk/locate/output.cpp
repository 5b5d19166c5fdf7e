#include "apps/iclk/locate/output.h"

#include <cmath>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/locate/priors.h"
#include "apps/iclk/pictures/pictures.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

Json vector_json(const Eigen::Vector3d& v) { return {number(v.x()), number(v.y()), number(v.z())}; }

/// Standard deviations of the position on the map, m.
Eigen::Vector3d position_sigma(const Located& l) {
  const Eigen::Matrix3d position = l.T_WC.R * l.covariance.topLeftCorner<3, 3>() * l.T_WC.R.transpose();
  return position.diagonal().cwiseMax(0).cwiseSqrt();
}

/// Of the attitude, degrees: the mean of the three axes.
double attitude_sigma(const Located& l) {
  return std::sqrt(std::max(0.0, l.covariance.bottomRightCorner<3, 3>().trace() / 3)) / kDegree;
}

Json sigma_json(const Located& l) {
  return {{"position", vector_json(position_sigma(l))}, {"attitude", number(attitude_sigma(l))}};
}

Json coordinates(const MapSystem& map, const Eigen::Vector3d& X) {
  const auto at = map.lat_lon(X.x(), X.y());
  return at ? Json{at->y(), at->x(), X.z()} : Json();
}

/// Throws Error(invalid_argument) for another word.
Status status_of(const std::string& word) {
  for (int i = 0; i <= static_cast<int>(Status::ambiguous); ++i)
    if (word == name(static_cast<Status>(i))) return static_cast<Status>(i);
  throw Error(ErrorCode::invalid_argument, "'" + word + "' is no status");
}

std::string text(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n"; }

}  // namespace

std::string located_json(const LocatedFrame& frame, const MapSystem& map) {
  const Located& l = frame.located;
  Json line = {{"schema", kLocatedSchema}, {"image", frame.image},   {"time", frame.time},
               {"status", frame.status()}, {"reason", l.reason},     {"hypotheses", l.hypotheses},
               {"rounds", l.rounds},       {"ms", number(frame.ms)}, {"model", l.model}};
  const Camera& c = frame.camera;
  line["camera"] = {number(c.fx), number(c.fy), number(c.cx), number(c.cy), c.width, c.height};
  if (frame.has_pose()) {
    line["position"] = vector_json(l.T_WC.t);
    if (const auto at = map.lat_lon(l.T_WC.t.x(), l.T_WC.t.y())) line["lat_lon"] = {at->x(), at->y()};
    line["yaw_pitch_roll"] = vector_json(yaw_pitch_roll(l.T_WC.R));
    line["omega_phi_kappa"] = vector_json(omega_phi_kappa(l.T_WC.R));
    line["T_WC"] = tum_line(l.T_WC);
    line["covariance"] = matrix_json(l.covariance);
    line["sigma"] = sigma_json(l);
    line["inliers"] = l.inliers;
    line["visible"] = l.visible;
    line["sigma_px"] = number(l.sigma);
    line["footprint"] = Json::array();
    for (const Eigen::Vector3d& X : frame.footprint) line["footprint"].push_back(vector_json(X));
  }
  if (!l.rivals.empty()) {
    line["rivals"] = Json::array();
    for (const SE3& rival : l.rivals) line["rivals"].push_back(tum_line(rival));
  }
  return text(line);
}

std::optional<LocatedFrame> parse_located_json(std::string_view text) {
  const Json line = parse_json(text);
  LocatedFrame frame;
  Located& l = frame.located;
  try {
    frame.image = line.at("image"), frame.time = line.at("time"), frame.ms = line.at("ms");
    const Json& c = line.at("camera");
    frame.camera = {c.at(0), c.at(1), c.at(2), c.at(3), c.at(4), c.at(5)};
    frame.tracked = line.at("status") == LocatedFrame::kTracked;
    if (!frame.tracked) l.status = status_of(line.at("status").get<std::string>());
    l.reason = line.at("reason"), l.model = line.at("model");
    l.hypotheses = line.at("hypotheses"), l.rounds = line.at("rounds");
    if (line.contains("rivals"))
      for (const Json& rival : line["rivals"]) l.rivals.push_back(parse_pose(rival.get<std::string>(), "rivals"));
    if (!frame.has_pose()) return frame;
    l.T_WC = parse_pose(line.at("T_WC").get<std::string>(), "T_WC");
    for (int i = 0; i < 36; ++i)
      l.covariance(i / 6, i % 6) = line.at("covariance").at(static_cast<size_t>(i / 6)).at(static_cast<size_t>(i % 6));
    l.inliers = line.at("inliers"), l.visible = line.at("visible"), l.sigma = line.at("sigma_px");
    for (const Json& X : line.at("footprint")) frame.footprint.emplace_back(X.at(0), X.at(1), X.at(2));
    return frame;
  } catch (const Json::exception&) {
  } catch (const Error&) {
  }
  return std::nullopt;
}

std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string csv_place(const MapSystem& map, const Eigen::Vector3d& X) {
  const auto at = map.lat_lon(X.x(), X.y());
  return (at ? fmt::format("{:.9f},{:.9f}", at->x(), at->y()) : ",") +
         fmt::format(",{:.4f},{:.4f},{:.4f}", X.x(), X.y(), X.z());
}

std::string located_csv(std::span<const LocatedFrame> frames, const MapSystem& map) {
  std::string lines =
      "image,time,status,lat,lon,x,y,z,yaw,pitch,roll,omega,phi,kappa,sigma_x,sigma_y,sigma_z,sigma_angle,inliers\n";
  for (const LocatedFrame& f : frames) {
    const Located& l = f.located;
    lines += fmt::format("{},{:.6f},{},", csv_cell(f.image), f.time, f.status());
    if (!f.has_pose()) {
      lines += std::string(15, ',') + "\n";
      continue;
    }
    const Eigen::Vector3d a = yaw_pitch_roll(l.T_WC.R), o = omega_phi_kappa(l.T_WC.R), s = position_sigma(l);
    lines += csv_place(map, l.T_WC.t) +
             fmt::format(",{:.5f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f}", a.x(), a.y(), a.z(), o.x(), o.y(), o.z()) +
             fmt::format(",{:.4g},{:.4g},{:.4g},{:.4g},{}\n", s.x(), s.y(), s.z(), attitude_sigma(l), l.inliers);
  }
  return lines;
}

std::string located_tum(std::span<const LocatedFrame> frames) {
  std::string lines = "# timestamp tx ty tz qx qy qz qw (camera to map)\n";
  for (const LocatedFrame& f : frames)
    if (f.has_pose()) lines += fmt::format("{:.6f} {}\n", f.time, tum_line(f.located.T_WC));
  return lines;
}

std::string located_geojson(std::span<const LocatedFrame> frames, const MapSystem& map) {
  if (!map.on_earth()) return "";
  Json features = Json::array();
  for (const LocatedFrame& f : frames) {
    if (!f.has_pose()) continue;
    const Json about = {{"image", f.image}, {"time", f.time}, {"status", f.status()}, {"sigma", sigma_json(f.located)}};
    features.push_back({{"type", "Feature"},
                        {"geometry", {{"type", "Point"}, {"coordinates", coordinates(map, f.located.T_WC.t)}}},
                        {"properties", about}});
    if (f.footprint.empty()) continue;
    Json ring = Json::array();
    for (const Eigen::Vector3d& X : f.footprint) ring.push_back(coordinates(map, X));
    ring.push_back(ring.front());
    features.push_back({{"type", "Feature"},
                        {"geometry", {{"type", "Polygon"}, {"coordinates", Json::array({ring})}}},
                        {"properties", about}});
  }
  return text({{"type", "FeatureCollection"}, {"features", features}});
}

cv::Mat located_overlay(const View& view, const cv::Mat& image, const Camera& camera) {
  PairInput pair;
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  cv::cvtColor(rgba, pair.image_0, cv::COLOR_RGBA2BGR);
  pair.image_1 = image;
  pair.camera = camera;
  return overlay_image(pair, cv::Mat(view.height, view.width, CV_32FC1, const_cast<float*>(view.depth.data())), SE3());
}

std::vector<Eigen::Vector3d> footprint_of(const View& view, const Camera& camera, const SE3& T_WC) {
  std::vector<Eigen::Vector3d> corners;
  for (const auto& [u, v] : {std::pair(0, 0), {view.width - 1, 0}, {view.width - 1, view.height - 1}, {0, view.height - 1}}) {
    const float z = view.depth[static_cast<size_t>(v) * static_cast<size_t>(view.width) + static_cast<size_t>(u)];
    if (!(z > 0)) return {};
    corners.push_back(T_WC * Eigen::Vector3d(z * camera.ray({u, v})));
  }
  return corners;
}

}  // namespace iclk
