#include <iclk/track/internal/unroller.h>

#include <algorithm>
#include <cmath>
#include <utility>

namespace iclk::internal {
namespace {

/// px at the first and the last row: an image with a larger remaining bend is unrolled again.
constexpr double kBend = 0.3;
constexpr int kAgain = 2;
/// The least share of the previous inliers; with fewer, the image is aligned again.
constexpr double kStillFound = 0.9;
/// The longest step between poses that gives a turn rate.
constexpr double kLongestStep = 0.25;  // s
constexpr double kLeastSigma = 0.1;    // px
/// rad: the prior sigma of a turn.
constexpr double kTurnSigma = 0.1;

/// The turn rate from the step since the last frame; nothing if that is too long ago.
std::optional<Eigen::Vector3d> step_rate(const Motion& motion, double time, const SE3& T_WC) {
  const double seconds = time - motion.last->time;
  if (motion.lost || seconds > kLongestStep) return {};
  return Eigen::Vector3d((motion.last->T_WC.inverse() * T_WC).log().tail<3>() / seconds);
}

}  // namespace

TrackFrame Unroller::unrolled(const TrackFrame& frame, const Eigen::Vector3d& with, FramePixels& to) const {
  if (readout_ == 0) return frame;
  internal::unroll(frame, camera_, rows_, with * readout_, to);
  return to.frame(camera_);
}

void Unroller::see(Frame& frame, const Eigen::Vector3d& with) {
  frame.see(unrolled(frame.given, with, flat_));
  flat_rate_ = with;
}

void Unroller::unroll(Frame& frame) {
  frame.rate = state.rate;
  if (readout_ != 0) see(frame, frame.rate);
}

void Unroller::straighten(Frame& frame) {
  if (readout_ != 0 && flat_rate_ != frame.rate) see(frame, frame.rate);
}

std::optional<TurnEstimate> Unroller::seen_turn(const Keyframe& k, const RefinedAlignment& a,
                                                const Eigen::Vector3d& turn_0) const {
  const std::vector<double>& sigma = k.features.inverse_depth_sigma;
  std::vector<RollingSighting> sightings;
  for (size_t i = 0; i < a.features.size(); ++i)
    if (a.features[i].status == FeatureStatus::aligned)
      sightings.push_back({k.features.uv[i], a.features[i].uv1, k.features.inverse_depth[i], i < sigma.size() ? sigma[i] : 0});
  return estimate_turn(camera_, rows_, a.T_10, turn_0, sightings, std::max(a.sigma, kLeastSigma), kTurnSigma);
}

/// The turn rate from the step and from the remaining bend of the unrolled image. The bend is relative to that of the keyframe.
/// Without the step, small errors of turns would accumulate from keyframe to keyframe.
TurnRate Unroller::rate_by(const std::optional<Eigen::Vector3d>& step, const Keyframe& k,
                           const std::optional<TurnEstimate>& seen) const {
  const TurnRate by_step{step.value_or(Eigen::Vector3d::Zero()), step ? state.changes.sigma() : RateChanges().sigma()};
  if (!seen) return by_step;
  const Eigen::Matrix3d covariance = seen->covariance + k.turn_sigma * k.turn_sigma * Eigen::Matrix3d::Identity();
  return by_step.with(state.rate + seen->turn / readout_, covariance / (readout_ * readout_));
}

/// The pose from the aligned features, moved according to the rate `now`, without a new alignment. Returns false if they do not
/// agree any more.
bool Unroller::pose_with(const Eigen::Vector3d& now, const Keyframe& k, Found& found) const {
  if (!found.confirmed) return false;
  RefinedAlignment a = found.alignment;
  for (AlignedFeature& f : a.features)
    if (f.status == FeatureStatus::aligned) f.uv1 = unrolled_anew(camera_, rows_, state.rate * readout_, now * readout_, f.uv1);
  const PoseResult pose = refine_pose(camera_, k.features, a.features, a.T_10);
  if (!usable(pose.status) || pose.inliers < kStillFound * a.inliers) return false;
  a.T_10 = pose.T_10;
  a.covariance = pose.covariance;
  a.inliers = pose.inliers;
  a.sigma = pose.sigma;
  a.reason = pose.reason + ", unrolled again";
  if (!judge_.confirmed(a)) return false;
  found.alignment = std::move(a);
  return true;
}

/// The same with a new alignment of the image, unrolled with that rate.
bool Unroller::align_with(const Eigen::Vector3d& now, Frame& frame, const Keyframe& k, const SE3& T_WC, Found& found) {
  see(frame, now);
  RefinedAlignment a = refiner_.align(pair_of(k, frame.seen(), T_WC));
  const bool confirmed = judge_.confirmed(a);
  if (!confirmed && (found.confirmed || !judge_.credible(a, k, T_WC))) return false;
  found.confirmed = confirmed;
  found.alignment = std::move(a);
  return true;
}

void Unroller::unroll_again(Frame& frame, const Keyframe& k, const Motion& motion, Found& found) {
  if (readout_ == 0 || motion.lost) return;
  for (int round = 0; round < kAgain; ++round) {
    const SE3 T_WC = k.T_WC * found.alignment.T_10.inverse();
    const auto seen = seen_turn(k, found.alignment, k.turn);
    if (!seen && round > 0) break;
    const Eigen::Vector3d now = rate_by(step_rate(motion, frame.given.time, T_WC), k, seen).rate;
    const double bend =
        (now - state.rate).norm() * std::abs(readout_) / 2 * std::max(std::abs(camera_.fx), std::abs(camera_.fy));
    if (bend < kBend) break;
    if (!pose_with(now, k, found) && !align_with(now, frame, k, T_WC, found)) break;
    frame.rate = state.rate = now;
  }
}

void Unroller::learn(const Frame& frame, const Keyframe& k, const Found& found, const Motion& motion, const SE3& T_WC) {
  const double time = frame.given.time;
  const auto step = step_rate(motion, time, T_WC);
  if (const auto& t = state.turned; step && t && t->time == motion.last->time)
    state.readout.add(t->turn, t->sigma, (t->T_WC_before.inverse() * T_WC).log().tail<3>() / (time - t->time_before));
  state.turned.reset();
  state.bent = {};
  if (readout_ != 0) {
    const TurnRate now = rate_by(step, k, found.confirmed ? seen_turn(k, found.alignment, k.turn) : std::nullopt);
    state.bent = {(now.rate - state.rate) * readout_, now.sigma * std::abs(readout_), Eigen::Vector3d::Zero()};
  }
  // The estimate from the step would depend on the given readout.
  const auto seen = found.confirmed ? seen_turn(k, found.alignment, k.seen_turn) : std::nullopt;
  if (seen && step) state.bent.seen = seen->turn;
  if (!step) {
    state.changes.interrupt();
    state.rate.setZero();
    return;
  }
  state.changes.add(*step);
  if (readout_ == 0) state.rate.setZero();
  if (seen)
    state.turned = State::Turned{time, motion.last->time, motion.last->T_WC, seen->turn + state.rate * readout_,
                                 std::sqrt(seen->covariance.trace() / 3)};
}

void Unroller::lose() {
  state.turned.reset();
  state.rate.setZero();
  state.changes.interrupt();
}

}  // namespace iclk::internal
