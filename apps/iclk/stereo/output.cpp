#include "apps/iclk/stereo/output.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/iclk/sets/pair_set.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

/// What `image` shows through the rotation into the rectified frame, black where it shows nothing.
cv::Mat rectified(const cv::Mat& image, const Camera& camera, const Eigen::Matrix3d& R) {
  const Undistorter turned(camera, {}, camera, R);
  cv::Mat out = turned.image(image).clone();
  if (!turned.seen().empty()) out.setTo(0, turned.seen() == 0);
  return out;
}

}  // namespace

std::string result_json(const StereoRunOptions& options, const StereoReport& report) {
  Json json;
  json["frame"] = "T_rl: X_right = R X_left + t";
  json["prior"] = pose_json(report.prior);
  if (options.flex) {
    json["mode"] = "flex";
    json["usable"] = report.flex.usable;
    json["mean"] = pose_json(report.flex.mean);
    json["epipolar_before_px"] = report.epipolar_before;
    json["epipolar_after_px"] = report.epipolar_after;
    Json pairs = Json::array();
    for (size_t i = 0; i < report.measurements.size(); ++i) {
      const FlexMeasurement& m = report.measurements[i];
      Json pair{{"time", m.time}, {"valid", m.valid}, {"reason", report.reasons[i]}, {"T_rl", pose_json(m.T_rl)}};
      if (report.flex.usable) {
        pair["smoothed"] = pose_json(report.flex.states[i].T_rl);
        pair["covariance"] = matrix_json(report.flex.states[i].covariance);
      }
      pairs.push_back(pair);
    }
    json["pairs"] = pairs;
    return json.dump(1) + "\n";
  }
  const RigResult& r = report.rig;
  json["mode"] = "rigid";
  json["usable"] = r.usable;
  json["reason"] = r.reason;
  json["T_rl"] = pose_json(r.T_rl);
  json["covariance"] = matrix_json(r.covariance);
  json["covariance_of"] = "xi in T_rl Exp(xi), [rho, phi]";
  json["scale_from_prior"] = r.scale_from_prior;
  json["moved"] = r.moved;
  json["chi_square"] = r.chi_square;
  json["threshold"] = r.threshold;
  json["epipolar_before_px"] = r.epipolar_before;
  json["epipolar_after_px"] = r.epipolar_after;
  json["sigma_px"] = r.sigma;
  json["inflation"] = r.inflation;
  json["pairs_used"] = r.pairs_used;
  json["sightings"] = r.sightings;
  json["inliers"] = r.inliers;
  Json pairs = Json::array();
  for (size_t i = 0; i < r.pairs.size(); ++i) {
    const RigPairReport& p = r.pairs[i];
    pairs.push_back({{"left", options.pairs[i].left},
                     {"right", options.pairs[i].right},
                     {"used", p.used},
                     {"status", name(p.status)},
                     {"reason", p.reason},
                     {"distance", p.distance},
                     {"sightings", p.sightings},
                     {"epipolar_before_px", p.epipolar_before},
                     {"epipolar_after_px", p.epipolar_after},
                     {"T_rl", pose_json(p.T_rl)}});
  }
  json["pairs"] = pairs;
  return json.dump(1) + "\n";
}

std::string series_csv(const StereoReport& report) {
  std::string out = "time,tx,ty,tz,qx,qy,qz,qw,sigma_t,sigma_rotation_degrees,valid\n";
  for (size_t i = 0; i < report.flex.states.size(); ++i) {
    const FlexState& s = report.flex.states[i];
    std::string pose = tum_line(s.T_rl);
    std::replace(pose.begin(), pose.end(), ' ', ',');
    out += fmt::format("{:.6f},{},{:.6g},{:.6g},{}\n", s.time, pose, std::sqrt(s.covariance.topLeftCorner<3, 3>().trace() / 3),
                       std::sqrt(s.covariance.bottomRightCorner<3, 3>().trace() / 3) / kDegree,
                       report.measurements[i].valid ? 1 : 0);
  }
  return out;
}

cv::Mat epipolar_picture(const StereoImages& images, const Camera& camera, const SE3& before, const SE3& after) {
  std::vector<cv::Mat> rows;
  for (const SE3& T : {before, after}) {
    const Rectification r = rectify(T);
    cv::Mat row, coloured;
    cv::hconcat(rectified(grey_8bit(images.left), camera, r.left), rectified(grey_8bit(images.right), camera, r.right), row);
    cv::cvtColor(row, coloured, cv::COLOR_GRAY2BGR);
    for (int k = 1; k < 10; ++k) {
      const int v = k * row.rows / 10;
      cv::line(coloured, {0, v}, {coloured.cols - 1, v}, k % 2 ? cv::Scalar(80, 220, 80) : cv::Scalar(60, 160, 255), 1);
    }
    cv::putText(coloured, rows.empty() ? "before" : "after", {8, 20}, cv::FONT_HERSHEY_SIMPLEX, 0.6, {255, 255, 255}, 2);
    rows.push_back(coloured);
  }
  cv::Mat out;
  cv::vconcat(rows, out);
  return out;
}

}  // namespace iclk
