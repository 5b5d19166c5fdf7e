#include "apps/iclk/sets/flight_files.h"

#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <Eigen/Geometry>

#include <iclk/session/io/pose_text.h>

namespace iclk {
namespace {

/// EuRoC's keys; without a pose, those that camera.txt needs.
std::string camera_yaml(const LensCamera& eye) {
  const Camera& c = eye.camera;
  const Distortion& d = eye.lens.distortion();
  std::string text = fmt::format("resolution: [{}, {}]\ncamera_model: pinhole\nintrinsics: [{}, {}, {}, {}]\n", c.width,
                                 c.height, c.fx, c.fy, c.cx, c.cy);
  if (d.empty()) return text;
  return text + fmt::format("distortion_model: {}\ndistortion_coefficients: [{}]\n",
                            d.model == Distortion::Model::radtan ? "radial-tangential" : "equidistant", fmt::join(d.k, ", "));
}

std::string sensor_yaml(const LensCamera& eye, const SE3& T_BS) {
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> M = T_BS.matrix();
  return fmt::format("%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{}]\n",
                     fmt::join(M.data(), M.data() + 16, ", ")) +
         camera_yaml(eye);
}

}  // namespace

FlightFiles::FlightFiles(std::vector<FlightFrame> frames, const RenderedCameras& cameras)
    : frames_(std::move(frames)), cameras_(cameras) {}

std::string FlightFiles::stamp(uint64_t index) const {
  const double time = frames_[index].time;
  return cameras_.rig ? fmt::format("{:019d}", std::llround(1e9 * time)) : fmt::format("{:.6f}", time);
}

std::vector<std::string> FlightFiles::folders() const {
  if (cameras_.rig) return {"cam0/data", "depth", "cam1/data"};
  return {"rgb", "depth"};
}

std::vector<std::string> FlightFiles::of_frame(uint64_t index) const {
  std::vector<std::string> files;
  for (const std::string& folder : folders())
    files.push_back(folder + "/" + stamp(index) + (folder == "depth" ? ".tiff" : ".png"));
  return files;
}

std::vector<std::pair<std::string, std::string>> FlightFiles::lists() const {
  if (!cameras_.rig) {
    std::string rgb = "# timestamp filename\n", depth = rgb, truth = "# timestamp tx ty tz qx qy qz qw (camera to world)\n";
    for (uint64_t i = 0; i < frames_.size(); ++i) {
      const std::vector<std::string> files = of_frame(i);
      rgb += stamp(i) + " " + files[0] + "\n";
      depth += stamp(i) + " " + files[1] + "\n";
      truth += stamp(i) + " " + tum_line(frames_[i].T_WC) + "\n";
    }
    const Camera& c = cameras_.left.camera;
    const std::string camera = cameras_.left.lens.empty() ? fmt::format("# fx fy cx cy width height\n{} {} {} {} {} {}\n", c.fx,
                                                                        c.fy, c.cx, c.cy, c.width, c.height)
                                                          : camera_yaml(cameras_.left);
    return {{"rgb.txt", rgb}, {"depth.txt", depth}, {"groundtruth.txt", truth}, {"camera.txt", camera}};
  }
  const SE3 T_bl = cameras_.rig->file.T_bl;
  std::string images = "#timestamp [ns],filename\n",
              truth = "#timestamp [ns],p_x [m],p_y,p_z,q_w,q_x,q_y,q_z (body to world)\n";
  for (uint64_t i = 0; i < frames_.size(); ++i) {
    images += stamp(i) + "," + stamp(i) + ".png\n";
    const SE3 T_WB = frames_[i].T_WC * T_bl.inverse();
    const Eigen::Quaterniond q(T_WB.R);
    truth += fmt::format("{},{},{},{},{},{},{},{}\n", stamp(i), T_WB.t.x(), T_WB.t.y(), T_WB.t.z(), q.w(), q.x(), q.y(), q.z());
  }
  return {{"cam0/data.csv", images},
          {"cam1/data.csv", images},
          {"cam0/sensor.yaml", sensor_yaml(cameras_.left, T_bl)},
          {"cam1/sensor.yaml", sensor_yaml(cameras_.rig->right, T_bl * cameras_.rig->T_rl.inverse())},
          {"state_groundtruth_estimate0/data.csv", truth}};
}

}  // namespace iclk
