#include <iclk/refine/internal/turn.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <iclk/refine/internal/reprojection.h>
#include <iclk/shaders/refine/refine.h>

namespace iclk::internal {
namespace {

constexpr double kLeastZ = 1e-3;

Eigen::Matrix3d turned(const Eigen::Vector3d& phi) {
  const double angle = phi.norm();
  return angle > 0 ? Eigen::AngleAxisd(angle, phi / angle).toRotationMatrix() : Eigen::Matrix3d::Identity();
}

/// The position of the feature in camera 1 at the time of its row.
Eigen::Vector3d seen(const RowTimes& rows, const SE3& T_10, const Eigen::Vector3d& turn, const Eigen::Vector3d& ray,
                     const RollingSighting& s) {
  return turned(-turn * rows.at(s.uv1)) * (T_10.R * ray + s.inverse_depth * T_10.t);
}

/// The scatter of a component in px, by the median, which is robust against bad sightings.
double scatter(const Camera& camera, const RowTimes& rows, const TurnEstimate& estimate,
               std::span<const RollingSighting> sightings) {
  std::vector<double> distances;
  for (const RollingSighting& s : sightings)
    if (const Eigen::Vector3d p = seen(rows, estimate.T_10, estimate.turn, camera.ray(s.uv0), s); p.z() > kLeastZ)
      distances.push_back((s.uv1 - camera.project(p)).norm());
  if (distances.empty()) return 0;
  const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
  std::nth_element(distances.begin(), middle, distances.end());
  return *middle / std::sqrt(2 * std::log(2.0));
}

}  // namespace

double TurnEstimate::chi2() const { return turn.dot(covariance.llt().solve(turn)); }

double TurnEstimate::bend(const Camera& camera) const {
  const double radius = std::max(camera.width, camera.height) / 4.0;  // of a typical pixel from the optical axis
  return Eigen::Vector3d(turn.x() * camera.fy, turn.y() * camera.fx, turn.z() * radius).norm() / 2;
}

bool TurnEstimate::proven(const Camera& camera) const {
  return chi2() > ICLK_TURN_PROVEN_CHI2 && bend(camera) > ICLK_TURN_PROVEN_BEND;
}

double TurnEstimate::probability() const {
  const Eigen::Matrix3d L = covariance.llt().matrixL();
  // The logarithm of the two likelihoods' ratio, by Laplace's approximation.
  const double odds = 0.5 * chi2() + L.diagonal().array().log().sum() - 3 * std::log(ICLK_TURN_EXPECTED);
  return 1 / (1 + std::exp(-odds));
}

Matrix6d TurnEstimate::doubt(const SE3& straight) const {
  const Vector6d way = (straight.inverse() * T_10).log();
  return probability() * (way * way.transpose() + pose_share);
}

std::optional<TurnEstimate> estimate_turn(const Camera& camera, const RowTimes& rows, const SE3& T_10,
                                          const Eigen::Vector3d& turn_0, std::span<const RollingSighting> sightings,
                                          double sigma, double prior_sigma) {
  if (sightings.size() < ICLK_TURN_SIGHTINGS) return {};
  using Vector9d = Eigen::Matrix<double, 9, 1>;
  using Matrix9d = Eigen::Matrix<double, 9, 9>;
  struct Fixed {
    Eigen::Vector3d ray;  // unrolled
    double at;            // time of the row in the target
  };
  std::vector<Fixed> fixed;
  fixed.reserve(sightings.size());
  for (const RollingSighting& s : sightings)
    fixed.push_back({turned(turn_0 * rows.at(s.uv0)) * camera.ray(s.uv0), rows.at(s.uv1)});
  TurnEstimate out;
  out.T_10 = T_10;
  const double prior = 1 / (prior_sigma * prior_sigma);
  Eigen::LLT<Matrix9d> solver;
  for (int iteration = 0; iteration < ICLK_TURN_ITERATIONS; ++iteration) {
    const SE3& T = out.T_10;
    Matrix9d H = Matrix9d::Zero();
    Vector9d b = Vector9d::Zero();
    for (size_t i = 0; i < sightings.size(); ++i) {
      const RollingSighting& s = sightings[i];
      const auto& [ray, at] = fixed[i];
      const Eigen::Matrix3d R = turned(-out.turn * at);
      const Eigen::Vector3d straight = T.R * ray + s.inverse_depth * T.t, p = R * straight;
      if (!(p.z() > kLeastZ)) continue;
      const Eigen::Matrix<double, 2, 3> J = camera.project_jacobian(p), JR = J * R, JRT = JR * T.R;
      Eigen::Matrix<double, 2, 9> A;  // [rho, phi] of the pose, turn
      A << JRT * s.inverse_depth, -JRT * hat(ray), at * J * hat(p);
      Eigen::Vector2d r = s.uv1 - camera.project(p);
      if (s.inverse_depth_sigma > 0) {
        // A depth error moves the feature along its epipolar line, as a turn may do.
        const Eigen::Vector2d moved = s.inverse_depth_sigma * (JR * T.t);
        const Eigen::LLT<Eigen::Matrix2d> noise(sigma * sigma * Eigen::Matrix2d::Identity() + moved * moved.transpose());
        noise.matrixL().solveInPlace(A);
        noise.matrixL().solveInPlace(r);
      } else {
        A /= sigma;
        r /= sigma;
      }
      const double w = 1 / (1 + r.squaredNorm() / (ICLK_TURN_CAUCHY * ICLK_TURN_CAUCHY));
      const Eigen::Matrix<double, 9, 2> weighted = w * A.transpose();
      H += weighted.lazyProduct(A);  // the general product of Eigen takes half of the time
      b += weighted.lazyProduct(r);
    }
    H.bottomRightCorner<3, 3>().diagonal().array() += prior;
    b.tail<3>() -= prior * out.turn;
    solver.compute(H);
    if (solver.info() != Eigen::Success) return {};
    const Vector9d step = solver.solve(b);
    if (!step.allFinite()) return {};
    out.T_10 = T * SE3::exp(step.head<6>());
    out.turn += step.tail<3>();
  }
  const Matrix9d C = solver.solve(Matrix9d::Identity());
  const Eigen::Matrix<double, 6, 3> cross = C.topRightCorner<6, 3>();
  out.covariance = C.bottomRightCorner<3, 3>();
  out.pose_share = cross * out.covariance.llt().solve(cross.transpose());
  return out;
}

std::optional<TurnEstimate> pair_turn(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10) {
  const RowTimes rows(camera);
  std::vector<RollingSighting> sightings;
  for (const Observation& o : observations(camera, features, aligned, T_10, ICLK_TURN_LEAST_SIGMA))
    sightings.push_back({o.uv0, o.uv1, o.q});
  double sigma = ICLK_TURN_FIRST_SIGMA;
  std::optional<TurnEstimate> found;
  for (int i = 0; i < ICLK_TURN_SCALES; ++i) {
    found = estimate_turn(camera, rows, found ? found->T_10 : T_10, Eigen::Vector3d::Zero(), sightings, sigma,
                          ICLK_TURN_PRIOR_SIGMA);
    if (!found) return {};
    sigma = std::max(ICLK_TURN_LEAST_SIGMA, scatter(camera, rows, *found, sightings));
  }
  return found;
}

Eigen::Vector2d unrolled(const Camera& camera, const Eigen::Vector3d& turn, const Eigen::Vector2d& uv) {
  return camera.project(turned(turn * row_time(camera, uv.y())) * camera.ray(uv));
}

}  // namespace iclk::internal
