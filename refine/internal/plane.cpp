#include <iclk/refine/internal/plane.h>

#include <algorithm>
#include <array>
#include <random>
#include <vector>

#include <Eigen/Dense>

namespace iclk::internal {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;

struct Match {
  Vector2d from, to;
};

/// Solves the linear equations with H(2, 2) = 1 by least squares, in units in which pixels are about 1.
Matrix3d homography(std::span<const Match> matches, double unit) {
  const auto n = static_cast<Eigen::Index>(matches.size());
  Eigen::Matrix<double, Eigen::Dynamic, 8> A(2 * n, 8);
  Eigen::VectorXd b(2 * n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const Match& m = matches[static_cast<size_t>(k)];
    const Vector2d x = m.from / unit, y = m.to / unit;
    A.row(2 * k) << x.x(), x.y(), 1, 0, 0, 0, -y.x() * x.x(), -y.x() * x.y();
    A.row(2 * k + 1) << 0, 0, 0, x.x(), x.y(), 1, -y.y() * x.x(), -y.y() * x.y();
    b.segment<2>(2 * k) = y;
  }
  const Eigen::Matrix<double, 8, 1> h = A.colPivHouseholderQr().solve(b);
  Matrix3d H;
  H << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1;
  const Eigen::DiagonalMatrix<double, 3> scale(unit, unit, 1);
  return scale * H * Eigen::DiagonalMatrix<double, 3>(1 / unit, 1 / unit, 1);
}

std::vector<Match> near(const Matrix3d& H, std::span<const Match> matches, double distance) {
  std::vector<Match> out;
  for (const Match& m : matches)
    if ((Vector2d((H * m.from.homogeneous()).hnormalized()) - m.to).norm() < distance) out.push_back(m);
  return out;
}

}  // namespace

int plane_inliers(const Features& features, std::span<const AlignedFeature> aligned, double inlier_distance) {
  constexpr int kHypotheses = 256, kSteps = 3;
  std::vector<Match> matches;
  double unit = 1;
  for (size_t i = 0; i < aligned.size(); ++i) {
    if (aligned[i].status != FeatureStatus::aligned) continue;
    matches.push_back({features.uv[i], aligned[i].uv1});
    unit = std::max(unit, features.uv[i].maxCoeff());
  }
  if (matches.size() < 4) return 0;
  std::mt19937 random(1);
  size_t most = 0;
  for (int h = 0; h < kHypotheses; ++h) {
    std::array<Match, 4> four;
    for (Match& m : four) m = matches[random() % matches.size()];
    Matrix3d H = homography(four, unit);
    size_t found = near(H, matches, inlier_distance).size();
    if (found < std::max<size_t>(most / 2, 8)) continue;
    for (int step = 0; step < kSteps; ++step) {
      H = homography(near(H, matches, 2 * inlier_distance), unit);
      found = std::max(found, near(H, matches, inlier_distance).size());
    }
    most = std::max(most, found);
  }
  return static_cast<int>(most);
}

}  // namespace iclk::internal
