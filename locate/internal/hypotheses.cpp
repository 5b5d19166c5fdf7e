#include <iclk/locate/internal/hypotheses.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

constexpr size_t kMost = 20000;            // poses
constexpr double kHeadingStep = M_PI / 6;  // the start search finds rolls up to 29 degrees
constexpr double kScaleStep = 1.25;        // between heights
constexpr double kShift = 0.5;             // of the shorter side of the picture on the ground, between positions

template <typename Number>
[[noreturn]] void refuse(Number poses) {
  throw Error(ErrorCode::invalid_argument, "the prior allows " + std::to_string(static_cast<uint64_t>(poses)) +
                                               " poses or more to compare, at most " + std::to_string(kMost) +
                                               " are possible; give smaller sigmas");
}

/// 0, step, -step, 2 step, ...: any value up to `range` is within half a step of one.
std::vector<double> steps(double range, double step) {
  std::vector<double> values = {0};
  const double n = std::ceil(range / step - 0.5);
  if (n > kMost) refuse(n);
  for (int i = 1; i <= n; ++i) values.insert(values.end(), {i * step, -i * step});
  return values;
}

std::vector<double> headings(double range) {
  if (range < M_PI - kHeadingStep / 2) return steps(range, kHeadingStep);
  std::vector<double> all;
  for (int i = 0; i < 12; ++i) all.push_back(i * kHeadingStep);
  return all;
}

/// A shift of the camera, and how unlikely it is, in sigmas.
struct Shift {
  Eigen::Vector3d by;
  double sigmas = 0;
};

std::vector<Shift> shifts(const LocatePrior& prior, const Camera& camera, double distance, double reach) {
  const double side = distance * std::min(camera.width / std::abs(camera.fx), camera.height / std::abs(camera.fy));
  // A tilt looks elsewhere: it moves the picture on the ground as a shift does.
  const double range = reach * prior.position_sigma + distance * std::tan(std::min(reach * prior.tilt_sigma, 1.0));
  const double step = kShift * side;
  const std::vector<double> along = steps(range, step);
  const std::vector<double> heights = steps(std::log1p(reach * prior.height_sigma / distance), std::log(kScaleStep));
  if (const size_t count = along.size() * along.size() * heights.size(); count > 2 * kMost) refuse(count);
  std::vector<Shift> all;
  for (const double e : heights)
    for (const double x : along)
      for (const double y : along) {
        const double out = std::hypot(x, y), up = distance * std::expm1(e);
        if (out > range + step / 2) continue;
        const double sigmas_up = prior.height_sigma > 0 ? up / prior.height_sigma : 0;
        all.push_back({{x, y, up}, std::hypot(range > 0 ? reach * out / range : 0, sigmas_up)});
      }
  std::stable_sort(all.begin(), all.end(), [](const Shift& a, const Shift& b) { return a.sigmas < b.sigmas; });
  return all;
}

}  // namespace

std::vector<SE3> hypotheses(const LocatePrior& prior, const Camera& camera, double distance, double reach) {
  const std::vector<Shift> all = shifts(prior, camera, distance, reach);
  const std::vector<double> turns = headings(reach * prior.heading_sigma);
  if (const size_t count = all.size() * turns.size(); count > kMost) refuse(count);
  std::vector<SE3> poses;
  for (const Shift& shift : all)
    for (const double heading : turns) {
      const Eigen::Matrix3d turn = Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()).toRotationMatrix();
      poses.push_back({turn * prior.T_WC.R, prior.T_WC.t + shift.by});
    }
  return poses;
}

bool likely(const SE3& T_WC, const LocatePrior& prior, double distance, double reach) {
  const Eigen::Vector3d off = T_WC.t - prior.T_WC.t;
  const double tilt = std::acos(std::clamp(T_WC.R.col(2).dot(prior.T_WC.R.col(2)), -1.0, 1.0));
  return off.head<2>().norm() < reach * prior.position_sigma + 0.1 * distance &&
         std::abs(off.z()) < reach * prior.height_sigma + 0.1 * distance && tilt < reach * prior.tilt_sigma + 0.09 &&
         likely_attitude(T_WC, prior, reach);
}

bool likely_attitude(const SE3& T_WC, const LocatePrior& prior, double reach) {
  const SE3 turn{T_WC.R * prior.T_WC.R.transpose(), Eigen::Vector3d::Zero()};
  return turn.angle() <= reach * (prior.heading_sigma + prior.tilt_sigma) + 0.5;
}

}  // namespace iclk::internal
