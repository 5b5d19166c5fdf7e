#include <algorithm>
#include <cmath>

#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace {

/// px at the first and the last row: an image that was unrolled so much wrongly is unrolled again.
constexpr double kBend = 0.3;
constexpr int kAgain = 2;
/// Of the features that agreed before: else the image has to be looked at again.
constexpr double kStillFound = 0.9;
/// Steps between poses say how fast a camera turns only so far apart.
constexpr double kLongestStep = 0.25;  // s
constexpr double kLeastSigma = 0.1;    // px
/// rad: so far at most may a camera turn that nothing is known of.
constexpr double kTurnSigma = 0.1;

}  // namespace

TrackFrame Tracker::Impl::unrolled(const TrackFrame& frame, const Eigen::Vector3d& with) {
  if (!rolls()) return frame;
  unroll(frame, camera, rows, with * options.readout, flat);
  flat_rate = with;
  return flat.frame(camera);
}

std::optional<Eigen::Vector3d> Tracker::Impl::step_rate(double time, const SE3& T_WC) const {
  const double seconds = time - last->time;
  if (lost || seconds > kLongestStep) return {};
  return Eigen::Vector3d((last->T_WC.inverse() * T_WC).log().tail<3>() / seconds);
}

std::optional<internal::TurnEstimate> Tracker::Impl::seen_turn(const Found& found, const Eigen::Vector3d& turn_0) const {
  const Keyframe& k = keyframes.all().at(found.keyframe);
  const RefinedAlignment& a = found.alignment;
  const std::vector<double>& sigma = k.features.inverse_depth_sigma;
  std::vector<internal::RollingSighting> sightings;
  for (size_t i = 0; i < a.features.size(); ++i)
    if (a.features[i].status == FeatureStatus::aligned)
      sightings.push_back({k.features.uv[i], a.features[i].uv1, k.features.inverse_depth[i], i < sigma.size() ? sigma[i] : 0});
  return internal::estimate_turn(camera, rows, a.T_10, turn_0, sightings, std::max(a.sigma, kLeastSigma), kTurnSigma);
}

/// A turn is seen in relation to the keyframe's. Without the step, turns that are a little wrong would add up from one keyframe
/// to the next.
TurnRate Tracker::Impl::rate_at(double time, const SE3& T_WC, const Found& found,
                                const std::optional<internal::TurnEstimate>& seen) const {
  const auto step = step_rate(time, T_WC);
  const TurnRate by_step{step.value_or(Eigen::Vector3d::Zero()), step ? rate_changes.sigma() : RateChanges().sigma()};
  if (!seen) return by_step;
  const double turn_0 = keyframes.all().at(found.keyframe).turn_sigma;
  const Eigen::Matrix3d covariance = seen->covariance + turn_0 * turn_0 * Eigen::Matrix3d::Identity();
  return by_step.with(rate + seen->turn / options.readout, covariance / (options.readout * options.readout));
}

bool Tracker::Impl::pose_with(const Eigen::Vector3d& now, Found& found) const {
  if (!found.confirmed) return false;
  const Keyframe& k = keyframes.all().at(found.keyframe);
  RefinedAlignment a = found.alignment;
  for (AlignedFeature& f : a.features)
    if (f.status == FeatureStatus::aligned)
      f.uv1 = unrolled_anew(camera, rows, rate * options.readout, now * options.readout, f.uv1);
  const PoseResult pose = refine_pose(camera, k.features, a.features, a.T_10, options.refiner.pose);
  if (!usable(pose.status) || pose.inliers < kStillFound * a.inliers) return false;
  a.T_10 = pose.T_10;
  a.covariance = pose.covariance;
  a.inliers = pose.inliers;
  a.sigma = pose.sigma;
  a.reason = pose.reason + ", unrolled anew";
  if (!confirmed(a)) return false;
  found.alignment = std::move(a);
  return true;
}

void Tracker::Impl::unroll_again(const TrackFrame& given, Found& found) {
  for (int round = 0; round < kAgain; ++round) {
    const Keyframe& k = *keyframes.find(found.keyframe);
    const SE3 T_WC = k.T_WC * found.alignment.T_10.inverse();
    const auto seen = seen_turn(found, k.turn);
    if (!seen && round > 0) break;
    const Eigen::Vector3d now = rate_at(given.time, T_WC, found, seen).rate;
    const double bend =
        (now - rate).norm() * std::abs(options.readout) / 2 * std::max(std::abs(camera.fx), std::abs(camera.fy));
    if (bend < kBend) break;
    if (!pose_with(now, found)) {
      RefinedAlignment a = refiner.align(pair_with(found.keyframe, unrolled(given, now), T_WC, false));
      if (!confirmed(a) && (found.confirmed || !credible(a, k, T_WC))) break;
      found.confirmed = confirmed(a);
      found.alignment = std::move(a);
    }
    rate = now;
  }
}

void Tracker::Impl::learn_turn(const Found& found, double time, const SE3& T_WC) {
  const auto step = step_rate(time, T_WC);
  if (step && turned && turned->time == last->time)
    readout.add(turned->turn, turned->sigma,
                (turned->T_WC_before.inverse() * T_WC).log().tail<3>() / (time - turned->time_before));
  turned.reset();
  bent = {};
  const Keyframe& k = keyframes.all().at(found.keyframe);
  if (rolls()) {
    const TurnRate now = rate_at(time, T_WC, found, found.confirmed ? seen_turn(found, k.turn) : std::nullopt);
    bent = {(now.rate - rate) * options.readout, now.sigma * std::abs(options.readout), Eigen::Vector3d::Zero()};
  }
  // By the step it would be what the readout given lets it be.
  const auto seen = found.confirmed ? seen_turn(found, k.seen_turn) : std::nullopt;
  if (seen && step) bent.seen = seen->turn;
  if (!step) {
    rate_changes.interrupt();
    rate.setZero();
    return;
  }
  rate_changes.add(*step);
  if (!rolls()) rate.setZero();
  if (seen)
    turned = Turned{time, last->time, last->T_WC, seen->turn + rate * options.readout, std::sqrt(seen->covariance.trace() / 3)};
}

}  // namespace iclk
