#include <iclk/track/trajectory.h>

#include <algorithm>
#include <cmath>

#include <Eigen/LU>
#include <Eigen/SVD>

namespace iclk {

TrajectoryError absolute_error(std::span<const PosePair> pairs) {
  TrajectoryError error;
  if (pairs.size() < 3) return error;
  Eigen::Vector3d mean_e = Eigen::Vector3d::Zero(), mean_t = Eigen::Vector3d::Zero();
  for (const PosePair& p : pairs) {
    mean_e += p.estimate.t;
    mean_t += p.truth.t;
  }
  const double n = static_cast<double>(pairs.size());
  mean_e /= n;
  mean_t /= n;
  Eigen::Matrix3d S = Eigen::Matrix3d::Zero();
  for (const PosePair& p : pairs) S += (p.truth.t - mean_t) * (p.estimate.t - mean_e).transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(S, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d signs(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
  error.alignment.R = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  error.alignment.t = mean_t - error.alignment.R * mean_e;
  std::vector<double> distances;
  double sum = 0;
  for (const PosePair& p : pairs) {
    distances.push_back((error.alignment * p.estimate.t - p.truth.t).norm());
    sum += distances.back() * distances.back();
  }
  std::sort(distances.begin(), distances.end());
  error.rmse = std::sqrt(sum / n);
  error.median = distances[distances.size() / 2];
  error.max = distances.back();
  return error;
}

RelativeError relative_error(std::span<const PosePair> pairs, int delta) {
  RelativeError error;
  double translation = 0, rotation = 0;
  const auto step = static_cast<size_t>(std::max(delta, 1));
  for (size_t i = 0; i + step < pairs.size(); ++i) {
    const SE3 estimate = pairs[i].estimate.inverse() * pairs[i + step].estimate;
    const SE3 truth = pairs[i].truth.inverse() * pairs[i + step].truth;
    const SE3 off = truth.inverse() * estimate;
    translation += off.t.squaredNorm();
    rotation += off.angle() * off.angle();
    ++error.count;
  }
  if (error.count == 0) return error;
  error.translation = std::sqrt(translation / error.count);
  error.rotation = std::sqrt(rotation / error.count);
  return error;
}

double way_length(std::span<const PosePair> pairs) {
  double sum = 0;
  for (size_t i = 1; i < pairs.size(); ++i) sum += (pairs[i].truth.t - pairs[i - 1].truth.t).norm();
  return sum;
}

}  // namespace iclk
