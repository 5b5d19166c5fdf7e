#include <iclk/refine/internal/uncertainty.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>

#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

constexpr double kFreedom = 3;  // degrees of freedom of Student's t

using PoseJacobian = Eigen::Matrix<double, 2, 6>;

/// Calls `each(i, p, J)` for the features that a pose projects into image 1: p is the point in camera 1 times its inverse depth
/// in camera 0, J the Jacobian by the pose.
template <class Each>
void each_seen(const Camera& camera, const Features& features, std::span<const FeatureCheck> checks, const SE3& T_10,
               const Each& each) {
  for (size_t i = 0; i < checks.size(); ++i) {
    if (checks[i] != FeatureCheck::ok) continue;
    const Eigen::Vector3d ray = camera.ray(features.uv[i]), p = T_10.R * ray + features.inverse_depth[i] * T_10.t;
    if (!(p.z() > 0) || !camera.contains(camera.project(p))) continue;
    each(i, p, reprojection_jacobian(camera, T_10, ray / features.inverse_depth[i]));
  }
}

/// The inverse of an information matrix; zero if it does not determine the pose.
Matrix6d inverse_of(const Matrix6d& H) {
  const Vector6d diagonal = H.diagonal();
  if (!(diagonal.minCoeff() > 0)) return Matrix6d::Zero();
  const Vector6d unit = diagonal.cwiseSqrt().cwiseInverse();  // for metres and radians
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(unit.asDiagonal() * H * unit.asDiagonal());
  if (!(eigen.eigenvalues()(0) > ICLK_LEAST_EIGENVALUE)) return Matrix6d::Zero();
  return unit.asDiagonal() * eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() *
         eigen.eigenvectors().transpose() * unit.asDiagonal();
}

/// q du1 / dq, px: the motion per relative error of the inverse depth.
Eigen::Vector2d along_epipolar(const Camera& camera, const Observation& o, const SE3& T_10) {
  const Eigen::Vector3d p = T_10.R * camera.ray(o.uv0) + o.q * T_10.t;
  return camera.project_jacobian(p) * T_10.t * o.q;
}

struct Sample {
  Eigen::Vector2d r, along;
  Eigen::Matrix2d covariance;
  double own = 0;  // relative sigma given for the feature's inverse depth; 0: unknown
};

double minus_log_likelihood(std::span<const Sample> samples, double floor, double depth, double share) {
  LogSum sum;  // this runs a hundred times per pair
  for (const Sample& s : samples) {
    const double sigma = s.own > 0 ? s.own : depth;
    const Eigen::Matrix2d C =
        s.covariance + floor * floor * Eigen::Matrix2d::Identity() + sigma * sigma * s.along * s.along.transpose();
    const double det = C.determinant();
    const double square = (s.r.y() * s.r.y() * C(0, 0) - 2 * s.r.x() * s.r.y() * C(0, 1) + s.r.x() * s.r.x() * C(1, 1)) / det;
    const double t = 1 + square / (share * kFreedom), t2 = t * t;
    static_assert(kFreedom == 3);
    sum.add(det * t2 * t2 * t);
  }
  return 0.5 * sum.value();
}

/// SharedErrors::calibration from the residuals `y`, with their Jacobians J by the pose and `calibration` by the calibration.
double calibration_sigma(const Eigen::MatrixXd& J, const Eigen::MatrixXd& calibration, const Eigen::VectorXd& y,
                         double variance) {
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(J);
  const Eigen::MatrixXd Q = qr.householderQ() * Eigen::MatrixXd::Identity(J.rows(), 6);
  const Eigen::MatrixXd seen = calibration - Q * (Q.transpose() * calibration);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(seen.transpose() * seen);
  // Along the eigenvectors the restricted likelihood is a product of three one-dimensional ones.
  const Eigen::Vector3d s = eigen.eigenvalues(), b = eigen.eigenvectors().transpose() * (seen.transpose() * y);
  constexpr int kSigmas = 10;
  std::array<double, kSigmas + 1> tau{}, log_weight{};
  for (int k = 0; k <= kSigmas; ++k) {
    if (k > 0) tau[k] = std::pow(0.02 * std::pow(100.0, static_cast<double>(k - 1) / (kSigmas - 1)), 2);
    log_weight[k] = k == 0 ? std::log(kSigmas) : 0;  // half of the prior's weight
    for (int j = 0; j < 3; ++j) {
      if (4 * s[j] < 1e-4 * variance) continue;  // even 2 px have no effect; for a plane, one direction is only rounding
      const double v = variance + tau[k] * s[j];
      log_weight[k] -= 0.5 * (std::log(v) + b[j] * b[j] / (s[j] * v));
    }
  }
  const double most = *std::max_element(log_weight.begin(), log_weight.end());
  double sum = 0, mean = 0;
  for (int k = 0; k <= kSigmas; ++k) {
    const double weight = std::exp(log_weight[k] - most);
    sum += weight;
    mean += weight * tau[k];
  }
  return std::sqrt(mean / sum);
}

}  // namespace

PositionErrors position_errors(const Camera& camera, std::span<const Observation> observations, const SE3& T_10,
                               const PoseOptions& options) {
  std::vector<Sample> samples;
  for (const Observation& o : observations) {
    const auto r = residual(camera, o, T_10);
    if (r && r->norm() <= 2 * options.inlier_distance)
      samples.push_back({*r, along_epipolar(camera, o, T_10), o.covariance, o.depth_sigma});
  }
  PositionErrors best{options.min_sigma, 0};
  if (samples.empty()) return best;
  const double n = 2 * static_cast<double>(samples.size());
  const double share = std::max(n - 6, 1.0) / n;  // six parameters were estimated
  struct Candidate {
    double floor, depth, cost;
  };
  std::vector<Candidate> candidates;
  constexpr int kFloors = 10, kDepths = 9;
  double least = std::numeric_limits<double>::infinity();
  const bool unknown = std::any_of(samples.begin(), samples.end(), [](const Sample& s) { return !(s.own > 0); });
  for (int d = 0; d <= (unknown && options.max_depth_sigma > 0 ? kDepths : 0); ++d) {
    // Zero, and from 1/64 of the largest value in factors of 1.68.
    const double depth =
        d == 0 ? 0 : options.max_depth_sigma * std::pow(64.0, static_cast<double>(d - kDepths) / (kDepths - 1));
    for (int f = 0; f < kFloors; ++f) {
      const double floor =
          options.min_sigma * std::pow(options.max_sigma / options.min_sigma, static_cast<double>(f) / (kFloors - 1));
      candidates.push_back({floor, depth, minus_log_likelihood(samples, floor, depth, share)});
      least = std::min(least, candidates.back().cost);
    }
  }
  double sum = 0, floors = 0, depths = 0;
  for (const Candidate& c : candidates) {
    const double weight = std::exp(least - c.cost);
    sum += weight;
    floors += weight * c.floor * c.floor;
    depths += weight * c.depth * c.depth;
  }
  best = {std::clamp(std::sqrt(floors / sum), options.min_sigma, options.max_sigma), std::sqrt(depths / sum)};
  return best;
}

void whiten(const Camera& camera, std::span<Observation> observations, const SE3& T_10, const PositionErrors& errors) {
  for (Observation& o : observations) {
    const double sigma = o.depth_sigma > 0 ? o.depth_sigma : errors.relative_depth;
    const Eigen::Vector2d along = sigma * along_epipolar(camera, o, T_10);
    o.W = whitening(o.covariance + along * along.transpose(), errors.floor);
  }
}

SharedErrors shared_errors(const Camera& camera, std::span<const Observation> observations, const SE3& T_10, double scale,
                           double relative_depth, std::optional<double> camera_sigma) {
  // Rows are whitened and weighted as in the M-estimator. Columns: six of the pose, then the shared parameters.
  const auto rows = static_cast<Eigen::Index>(2 * observations.size());
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(rows, 6), calibration = Eigen::MatrixXd::Zero(rows, 3);
  Eigen::VectorXd depth = Eigen::VectorXd::Zero(rows), y = Eigen::VectorXd::Zero(rows);
  double psi2 = 0, weights = 0;
  for (size_t i = 0; i < observations.size(); ++i) {
    const Observation& o = observations[i];
    const auto r = residual(camera, o, T_10);
    if (!r) continue;
    const Eigen::Vector2d white = o.W * *r;
    const double w = 1 / (1 + white.squaredNorm() / (scale * scale));
    const Eigen::Matrix2d sqrt_W = std::sqrt(w) * o.W;
    const auto row = static_cast<Eigen::Index>(2 * i);
    const Eigen::Vector3d ray = camera.ray(o.uv0), p = T_10.R * ray + o.q * T_10.t;
    const Eigen::Matrix<double, 2, 3> du1_dray = camera.project_jacobian(p) * T_10.R;
    const double focal = 0.5 * (std::abs(camera.fx) + std::abs(camera.fy));  // both change by the same factor
    Eigen::Matrix<double, 2, 3> dc;
    dc.col(0) = Eigen::Vector2d::UnitX() - du1_dray.col(0) / camera.fx;
    dc.col(1) = Eigen::Vector2d::UnitY() - du1_dray.col(1) / camera.fy;
    dc.col(2) = (camera.project(p) - Eigen::Vector2d(camera.cx, camera.cy) - du1_dray.leftCols<2>() * ray.head<2>()) / focal;
    y.segment<2>(row) = sqrt_W * *r;
    J.middleRows<2>(row) = sqrt_W * reprojection_jacobian(camera, T_10, ray / o.q);
    calibration.middleRows<2>(row) = sqrt_W * dc;
    depth.segment<2>(row) = sqrt_W * (o.depth_sigma > 0 ? o.depth_sigma : relative_depth) * along_epipolar(camera, o, T_10);
    psi2 += w * w * white.squaredNorm();
    weights += w;
  }
  const double variance =
      psi2 / std::max<double>(static_cast<double>(rows) - 6, 1) / (weights / static_cast<double>(observations.size()));
  SharedErrors shared;
  if (!(variance > 0)) return shared;

  shared.calibration = camera_sigma.value_or(0);
  if (!camera_sigma) shared.calibration = calibration_sigma(J, calibration, y, variance);
  const Eigen::LDLT<Matrix6d> H(J.transpose() * J);
  const Eigen::Matrix<double, 6, 3> by_calibration = H.solve(J.transpose() * calibration);
  const Vector6d by_depth = ICLK_COMMON_DEPTH * H.solve(J.transpose() * depth);
  shared.covariance =
      shared.calibration * shared.calibration * by_calibration * by_calibration.transpose() + by_depth * by_depth.transpose();
  return shared;
}

Matrix6d depth_covariance(const Camera& camera, const Features& features, std::span<const FeatureCheck> checks, const SE3& T_10,
                          double relative_depth, double common_sigma) {
  int seen = 0;
  Matrix6d H = Matrix6d::Zero(), single = Matrix6d::Zero();
  Vector6d common = Vector6d::Zero();
  each_seen(camera, features, checks, T_10, [&](size_t i, const Eigen::Vector3d& p, const PoseJacobian& J) {
    const double q = features.inverse_depth[i];
    const double own = i < features.inverse_depth_sigma.size() ? features.inverse_depth_sigma[i] / q : 0;
    const Vector6d s = J.transpose() * (camera.project_jacobian(p) * T_10.t * q) * (own > 0 ? own : relative_depth);
    H += J.transpose() * J;
    single += s * s.transpose();
    common += ICLK_COMMON_DEPTH * s;
    ++seen;
  });
  const Matrix6d inverse = inverse_of(H);
  return inverse * (single + common * common.transpose()) * inverse + seen * common_sigma * common_sigma * inverse;
}

Matrix6d shift_covariance(const Camera& camera, const Features& features, std::span<const FeatureCheck> checks, const SE3& T_10,
                          double sigma) {
  Matrix6d H = Matrix6d::Zero();
  Eigen::Matrix<double, 6, 2> shift = Eigen::Matrix<double, 6, 2>::Zero();
  each_seen(camera, features, checks, T_10, [&](size_t, const Eigen::Vector3d&, const PoseJacobian& J) {
    H += J.transpose() * J;
    shift += J.transpose();
  });
  const Eigen::Matrix<double, 6, 2> by_shift = sigma * inverse_of(H) * shift;
  return by_shift * by_shift.transpose();
}

}  // namespace iclk::internal
