// Jacobians against differences.
#include <random>

#include <gtest/gtest.h>

#include <iclk/rig/internal/costs.h>

namespace iclk {
namespace {

const Camera kRight{340, 335, 170, 115, 340, 230};

/// Every block's Jacobian of `cost` at `blocks`, by central differences in the ambient space.
void check_jacobians(const ceres::CostFunction& cost, std::vector<std::vector<double>> blocks, double tolerance) {
  const int rows = cost.num_residuals();
  const auto evaluate = [&] {
    std::vector<const double*> pointers;
    for (const auto& b : blocks) pointers.push_back(b.data());
    Eigen::VectorXd r(rows);
    EXPECT_TRUE(cost.Evaluate(pointers.data(), r.data(), nullptr));
    return r;
  };
  std::vector<std::vector<double>> jacobians;
  std::vector<const double*> pointers;
  std::vector<double*> to;
  for (const auto& b : blocks) {
    jacobians.emplace_back(b.size() * static_cast<size_t>(rows));
    pointers.push_back(b.data());
  }
  for (auto& j : jacobians) to.push_back(j.data());
  Eigen::VectorXd r(rows);
  ASSERT_TRUE(cost.Evaluate(pointers.data(), r.data(), to.data()));
  for (size_t b = 0; b < blocks.size(); ++b)
    for (size_t k = 0; k < blocks[b].size(); ++k) {
      const double x = blocks[b][k], h = 1e-6;
      blocks[b][k] = x + h;
      const Eigen::VectorXd up = evaluate();
      blocks[b][k] = x - h;
      const Eigen::VectorXd down = evaluate();
      blocks[b][k] = x;
      for (int i = 0; i < rows; ++i) {
        const double expected = (up[i] - down[i]) / (2 * h);
        EXPECT_NEAR(jacobians[b][static_cast<size_t>(i) * blocks[b].size() + k], expected, tolerance * (1 + std::abs(expected)))
            << "block " << b << ", row " << i << ", column " << k;
      }
    }
}

std::vector<double> block_of(const SE3& T) {
  const internal::PoseBlock b = internal::to_block(T);
  return {b.data(), b.data() + 12};
}

SE3 some_pose() { return SE3::exp((Vector6d() << -0.5, 0.1, 0.05, 0.1, -0.2, 0.15).finished()); }

TEST(Costs, OfASighting) {
  const Eigen::Matrix2d W = (Eigen::Matrix2d() << 2, 0.3, 0.3, 1).finished();
  check_jacobians(internal::ReprojectionCost(kRight, {0.2, -0.1, 1}, {100, 80}, W, internal::kLeastDepth),
                  {block_of(some_pose()), {0.3}}, 1e-5);
  // Behind the camera there is no residual.
  const SE3 back = SE3::exp((Vector6d() << 0, 0, 0, 0, 3.1, 0).finished());
  const std::vector<double> pose = block_of(back);
  const double q = 0.1;
  const double* pointers[] = {pose.data(), &q};
  double r[2];
  EXPECT_FALSE(internal::ReprojectionCost(kRight, {0, 0, 1}, {1, 1}, W, internal::kLeastDepth).Evaluate(pointers, r, nullptr));
}

TEST(Costs, OfPriors) {
  check_jacobians(internal::DepthPriorCost(0.2, 100), {{0.25}}, 1e-7);
  check_jacobians(internal::BaselineCost(0.6, 0.01), {block_of(some_pose())}, 1e-6);
  internal::State sigma;
  sigma << 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12;
  check_jacobians(internal::BoundCost(sigma), {std::vector<double>(12, 0.5)}, 1e-7);
}

TEST(Costs, OfABendingRig) {
  Matrix6d L;
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  for (int k = 0; k < 36; ++k) L(k) = normal(random);
  const SE3 measured = some_pose() * SE3::exp((Vector6d() << 0.01, 0.02, -0.01, 0.03, 0.02, -0.04).finished());
  // The series of the Jacobian of Log is good to the fourth power of the angle.
  check_jacobians(internal::MeasurementCost(measured, L * L.transpose() + Matrix6d::Identity(), some_pose()),
                  {{0.02, 0.01, -0.03, 0.05, -0.04, 0.03, 1, 2, 3, 4, 5, 6}}, 1e-5);
  check_jacobians(internal::MotionCost(0.05, (Vector6d() << 1, 2, 3, 4, 5, 6).finished()),
                  {{1, 2, 3, 4, 5, 6, 6, 5, 4, 3, 2, 1}, {2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7}}, 1e-6);
}

TEST(Costs, MotionHasTheCovarianceOfWhiteAcceleration) {
  // W^T W is the inverse of density [dt^3/3, dt^2/2; dt^2/2, dt].
  const double dt = 0.1, density = 2;
  internal::MotionCost cost(dt, Vector6d::Constant(density));
  const std::vector<double> zero(12, 0.0);
  std::vector<double> j0(144), j1(144);
  const double* pointers[] = {zero.data(), zero.data()};
  double* jacobians[] = {j0.data(), j1.data()};
  double r[12];
  ASSERT_TRUE(cost.Evaluate(pointers, r, jacobians));
  const Eigen::Map<const Eigen::Matrix<double, 12, 12, Eigen::RowMajor>> W(j1.data());
  const Eigen::Matrix<double, 12, 12> Q = (W.transpose() * W).inverse();
  EXPECT_NEAR(Q(3, 3), density * dt * dt * dt / 3, 1e-9);
  EXPECT_NEAR(Q(3, 9), density * dt * dt / 2, 1e-9);
  EXPECT_NEAR(Q(9, 9), density * dt, 1e-9);
}

}  // namespace
}  // namespace iclk
