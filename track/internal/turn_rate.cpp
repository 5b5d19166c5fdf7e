#include <iclk/track/internal/turn_rate.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/LU>

namespace iclk::internal {
namespace {

/// Changes of the turn rate: the number that is averaged, the least number for an estimate, and its lower bound in rad/s.
constexpr int kChanges = 30, kLeastChanges = 3;
constexpr double kLeastChange = 0.01;
/// rad/s: the change of the turn rate between frames of a hand-held camera.
constexpr double kHandSigma = 1;
/// The least turn rate from which the readout is estimated, rad/s.
constexpr double kLeastRate = 0.2;
/// rad: the error of turns apart from that of positions.
constexpr double kTurnNoise = 2e-3;
/// s: the width of a bin of votes; there are kVotes bins on each side of zero.
constexpr double kVote = 5e-4;
constexpr int kVotes = 200;
constexpr double kLeastFrames = 5;

}  // namespace

TurnRate TurnRate::with(const Eigen::Vector3d& other, const Eigen::Matrix3d& covariance) const {
  const Eigen::Matrix3d W = covariance.inverse(), sum = (W + Eigen::Matrix3d::Identity() / (sigma * sigma)).inverse();
  return {sum * (W * other + rate / (sigma * sigma)), std::sqrt(sum.trace() / 3)};
}

void RateChanges::add(const Eigen::Vector3d& rate) {
  if (follows_) {
    count_ = std::min(count_ + 1, kChanges);
    square_ += ((rate - last_).squaredNorm() / 3 - square_) / count_;
  }
  last_ = rate;
  follows_ = true;
}

double RateChanges::sigma() const { return count_ < kLeastChanges ? kHandSigma : std::max(std::sqrt(square_), kLeastChange); }

ReadoutEstimate::ReadoutEstimate() : votes_(static_cast<size_t>(2 * kVotes)) {}

void ReadoutEstimate::add(const Eigen::Vector3d& turn, double sigma, const Eigen::Vector3d& rate) {
  if (!(rate.norm() > kLeastRate) || !turn.allFinite()) return;
  const double seconds = turn.dot(rate) / rate.squaredNorm(), noise = std::hypot(sigma, kTurnNoise);
  const auto bin = static_cast<int>(std::floor(seconds / kVote)) + kVotes;
  const double weight = rate.squaredNorm() / (noise * noise);
  votes_[static_cast<size_t>(std::clamp(bin, 0, 2 * kVotes - 1))] += weight;
  weight_ += weight;
  weight2_ += weight * weight;
}

/// Interpolates as if the votes of a bin were uniform.
double ReadoutEstimate::quantile(double share) const {
  double below = 0;
  for (size_t i = 0; i < votes_.size(); ++i) {
    if (votes_[i] > 0 && below + votes_[i] >= share * weight_)
      return (static_cast<double>(i) - kVotes + (share * weight_ - below) / votes_[i]) * kVote;
    below += votes_[i];
  }
  return 0;
}

double ReadoutEstimate::seconds() const { return quantile(0.5); }

double ReadoutEstimate::sigma() const {
  const double frames = weight_ > 0 ? weight_ * weight_ / weight2_ : 0;  // the effective number of frames
  if (frames < kLeastFrames) return std::numeric_limits<double>::infinity();
  const double spread = (quantile(0.84) - quantile(0.16)) / 2;
  return 1.25 * spread / std::sqrt(frames);  // of a median
}

}  // namespace iclk::internal
