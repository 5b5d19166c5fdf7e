#include <iclk/rig/internal/common_pose.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <random>
#include <utility>

#include <Eigen/Cholesky>

namespace iclk::internal {
namespace {

constexpr double kMedian = 5.35, kHalf = 12.6;  // chi^2 of six degrees: 50 % and 95 %
constexpr size_t kCandidates = 200;

double squared(const PoseVote& vote, const Eigen::LDLT<Matrix6d>& covariance, const SE3& T) {
  const Vector6d e = (vote.T.inverse() * T).log();
  const double d = e.dot(covariance.solve(e));
  return d >= 0 ? d : std::numeric_limits<double>::infinity();
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The votes to start at: all, or a reproducible random sample.
std::vector<size_t> candidates(size_t votes) {
  std::vector<size_t> order(votes);
  std::iota(order.begin(), order.end(), size_t{0});
  if (votes <= kCandidates) return order;
  std::mt19937 random(1);
  for (size_t i = 0; i < kCandidates; ++i) std::swap(order[i], order[i + random() % (votes - i)]);
  order.resize(kCandidates);
  return order;
}

}  // namespace

SE3 common_pose(std::vector<PoseVote>& votes) {
  std::vector<Eigen::LDLT<Matrix6d>> covariances;
  for (const PoseVote& v : votes) covariances.emplace_back(v.covariance);
  const auto distances_from = [&](const SE3& T) {
    std::vector<double> distances;
    for (size_t k = 0; k < votes.size(); ++k) distances.push_back(squared(votes[k], covariances[k], T));
    return distances;
  };
  SE3 T = votes.front().T;
  double least = std::numeric_limits<double>::infinity();
  for (const size_t candidate : candidates(votes.size()))
    if (const double m = median(distances_from(votes[candidate].T)); m < least) {
      least = m;
      T = votes[candidate].T;
    }
  for (int i = 0; i < 20; ++i) {
    const std::vector<double> distances = distances_from(T);
    const double spread = std::max(1.0, median(distances) / kMedian);
    Matrix6d H = Matrix6d::Zero();
    Vector6d g = Vector6d::Zero();
    for (size_t k = 0; k < votes.size(); ++k) {
      PoseVote& v = votes[k];
      v.distance = distances[k] / spread;
      v.weight = 1 / (1 + v.distance / kHalf);
      // e(xi) = Log(T_i^-1 T Exp(xi)) = e + J_r^-1(e) xi; the series is inaccurate for large e, but then the weight is small.
      const Vector6d e = (v.T.inverse() * T).log();
      const Matrix6d J = e.norm() < 0.5 ? inverse_right_jacobian(e) : Matrix6d::Identity();
      const Matrix6d JtI = J.transpose() * covariances[k].solve(Matrix6d::Identity());
      H += v.weight * JtI * J;
      g += v.weight * JtI * e;
    }
    const Vector6d step = -H.ldlt().solve(g);
    if (!step.allFinite()) break;
    T = T * SE3::exp(step);
    if (step.norm() < 1e-12) break;
  }
  T.orthonormalize();
  return T;
}

}  // namespace iclk::internal
