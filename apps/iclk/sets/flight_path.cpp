#include "apps/iclk/sets/flight_path.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include <iclk/engine/error.h>

#include "apps/json/format.h"

namespace iclk {
namespace {

constexpr double kLatest = 9e9;     // s, so that nanoseconds fit into 64 bits
constexpr double kSameTime = 1e-6;  // s: what lists of files resolve
constexpr uint64_t kMostFrames = 10000000;

/// A pose at a time, from those at two others; beyond them as well.
StampedPose between(const StampedPose& a, const StampedPose& b, double time) {
  const double s = (time - a.stamp) / (b.stamp - a.stamp);
  const SE3 turn{a.T_wc.R.transpose() * b.T_wc.R, Eigen::Vector3d::Zero()};
  return {time, {a.T_wc.R * SE3::exp(s * turn.log()).R, (1 - s) * a.T_wc.t + s * b.T_wc.t}};
}

}  // namespace

FlightPath::FlightPath(std::vector<StampedPose> poses, const std::string& source) : poses_(std::move(poses)) {
  const auto fail = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, source + ": " + why); };
  if (poses_.empty()) fail("has no pose; give lines 'timestamp tx ty tz qx qy qz qw'");
  if (!(begin() >= 0) || !(end() < kLatest))
    fail(formatted("has times from %.12g to %.12g s; they must be 0 to %.12g", begin(), end(), kLatest));
  for (size_t i = 1; i < poses_.size(); ++i)
    if (!(poses_[i].stamp - poses_[i - 1].stamp >= kSameTime)) fail(formatted("has two poses at %.12g s", poses_[i].stamp));
}

SE3 FlightPath::at(double time) const {
  const auto after =
      std::lower_bound(poses_.begin(), poses_.end(), time, [](const StampedPose& p, double t) { return p.stamp < t; });
  if (after == poses_.end()) return poses_.back().T_wc;
  if (after->stamp == time || after == poses_.begin()) return after->T_wc;
  const auto before = after - 1;
  const StampedPose line = between(*before, *after, time);
  // Parabolas through three poses each, where there is a third, are blended.
  StampedPose left = line, right = line;
  if (before != poses_.begin()) {
    const StampedPose outer = between(*(before - 1), *before, time);
    left = between({(before - 1)->stamp, outer.T_wc}, {after->stamp, line.T_wc}, time);
  }
  if (after + 1 != poses_.end()) {
    const StampedPose outer = between(*after, *(after + 1), time);
    right = between({before->stamp, line.T_wc}, {(after + 1)->stamp, outer.T_wc}, time);
  }
  SE3 pose = between({before->stamp, left.T_wc}, {after->stamp, right.T_wc}, time).T_wc;
  pose.orthonormalize();
  return pose;
}

std::vector<double> FlightPath::times(double rate, double readout) const {
  std::vector<double> all, kept;
  if (rate > 0) {
    const double count = (end() - begin()) * rate;
    if (count > static_cast<double>(kMostFrames))
      throw Error(ErrorCode::invalid_argument, formatted("%.12g frames at %.12g a second are more than %zu; take a lower rate",
                                                         count, rate, static_cast<size_t>(kMostFrames)));
    for (uint64_t k = 0; static_cast<double>(k) <= count + 1e-6; ++k)
      all.push_back(std::min(begin() + static_cast<double>(k) / rate, end()));
  } else {
    for (const StampedPose& pose : poses_) all.push_back(pose.stamp);
  }
  for (const double t : all)
    if (t - 0.5 * readout >= begin() - 1e-9 && t + 0.5 * readout <= end() + 1e-9) kept.push_back(t);
  return kept;
}

}  // namespace iclk
