#include <iclk/locate/internal/map_errors.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/QR>

namespace iclk::internal {
namespace {

constexpr double kIndependent = 16;  // errors in a picture
constexpr double kShift = 0.3;       // texels: standard deviation of an error that all points share, along x and y
constexpr double kHeight = 0.1;      // steps of the heights: the same along z, and of each height
constexpr double kByLight = 0.6;     // of the roughness: standard deviation by which another sun moves the ground
constexpr double kAround = 7.5;      // m: roughness is that of the heights so far away, at most
constexpr double kCrown = 3.6;       // m: heights so far apart flatten crowns to 1/e
constexpr double kFlattest = 4;      // most by which flattened heights are corrected
constexpr int kHeights = 5;          // a side
constexpr int kFewestHeights = 6;

using Matrix26 = Eigen::Matrix<double, 2, 6>;

/// What moves the point in the image, for the pose T_WC Exp(xi).
Matrix26 jacobian(const Camera& camera, const Eigen::Vector3d& X) {
  const Eigen::Matrix<double, 2, 3> project = camera.project_jacobian(X);
  Matrix26 J;  // the point is seen at Exp(-xi) X
  J << -project, project * hat(X);
  return J;
}

}  // namespace

Matrix6d map_covariance(const Camera& camera, std::span<const Eigen::Vector3d> points, const Eigen::Matrix3d& R_WC,
                        const MapErrors& errors) {
  const double height = kHeight * errors.height, shift = kShift * errors.texel;
  Matrix6d H = Matrix6d::Zero();
  Eigen::Matrix<double, 6, 2> moved = Eigen::Matrix<double, 6, 2>::Zero();
  for (size_t i = 0; i < points.size(); ++i) {
    const Matrix26 J = jacobian(camera, points[i]);
    const Eigen::Matrix<double, 2, 3> to_image = camera.project_jacobian(points[i]) * R_WC.transpose();
    const Eigen::Vector2d raised = height * to_image.col(2);
    const Eigen::Matrix2d covariance = errors.sigma * errors.sigma * Eigen::Matrix2d::Identity() + raised * raised.transpose();
    const Eigen::Matrix<double, 6, 2> weighted = J.transpose() * covariance.inverse();
    H += weighted * J;
    if (!errors.roughness.empty()) moved += kByLight * errors.roughness[i] * weighted * to_image.leftCols<2>();
  }
  const Eigen::LDLT<Matrix6d> factor(H);
  if (points.size() < 3 || factor.vectorD().minCoeff() <= 1e-10 * factor.vectorD().maxCoeff()) return Matrix6d::Zero();
  const double n = static_cast<double>(points.size());
  Matrix6d covariance = std::max(1.0, n / kIndependent) * factor.solve(Matrix6d::Identity());
  const Eigen::Vector3d shared(shift * shift, shift * shift, height * height);
  covariance.topLeftCorner<3, 3>() += R_WC.transpose() * shared.asDiagonal() * R_WC;
  const Eigen::Matrix<double, 6, 2> by_light = factor.solve(moved);
  covariance += by_light * by_light.transpose();
  return 0.5 * (covariance + covariance.transpose());
}

double ground_roughness(const Terrain& terrain, double x, double y) {
  constexpr double step = 2 * kAround / (kHeights - 1);
  Eigen::Matrix<double, Eigen::Dynamic, 3, 0, kHeights * kHeights, 3> places(kHeights * kHeights, 3);
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kHeights * kHeights, 1> heights(kHeights * kHeights);
  Eigen::Index known = 0;
  for (int i = 0; i < kHeights * kHeights; ++i) {
    const double dx = (i % kHeights) * step - kAround, dy = (i / kHeights) * step - kAround;
    const auto height = terrain.height_at(x + dx, y + dy);
    if (!height) continue;
    places.row(known) << 1, dx, dy;
    heights[known++] = *height;
  }
  if (known < kFewestHeights) return 0;
  const auto A = places.topRows(known);
  const auto b = heights.head(known);
  const Eigen::Vector3d plane = A.colPivHouseholderQr().solve(b);
  const double spread = std::max(terrain.relief.step_x, terrain.relief.step_y) / kCrown;
  const double flattened = std::min(std::exp(spread * spread), kFlattest);
  return flattened * std::sqrt((b - A * plane).squaredNorm() / static_cast<double>(known - 3));
}

double ground_sigma(const Camera& camera, std::span<const Eigen::Vector3d> points, const Matrix6d& covariance) {
  double sum = 0;
  for (const Eigen::Vector3d& X : points) {
    const Matrix26 J = X.z() / camera.fx * jacobian(camera, X);
    sum += 0.5 * (J * covariance * J.transpose()).trace();
  }
  return std::sqrt(sum / std::max<double>(1, static_cast<double>(points.size())));
}

}  // namespace iclk::internal
