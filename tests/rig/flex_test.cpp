// A rig that swings as a known sinusoid.
#include <cmath>
#include <ctime>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/engine/error.h>
#include <iclk/rig/flex.h>
#include <iclk/rig/internal/chain.h>
#include <iclk/rig/internal/common_pose.h>

namespace iclk {
namespace {

const SE3 kRest{Eigen::Matrix3d::Identity(), {-1.5, 0, 0.02}};

SE3 swing(double time, double frequency) {
  const double a = std::sin(2 * M_PI * frequency * time);
  Vector6d xi;
  xi << 0, 0.05 * a, 0.01 * a, 0.02 * a, 0.01 * a, 0.052 * a;
  return kRest * SE3::exp(xi);
}

std::vector<FlexMeasurement> series(double frequency, double rate, double rotation, double translation, unsigned seed = 1,
                                    int moments = 60) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  std::vector<FlexMeasurement> out;
  for (int i = 0; i < moments; ++i) {
    FlexMeasurement m;
    m.time = i / rate;
    Vector6d sigma, xi;
    sigma << translation, translation, translation, rotation, rotation, rotation;
    for (int k = 0; k < 6; ++k) xi[k] = sigma[k] * normal(random);
    m.T_rl = swing(m.time, frequency) * SE3::exp(xi);
    m.covariance = sigma.cwiseAbs2().asDiagonal();
    m.valid = true;
    out.push_back(m);
  }
  return out;
}

struct Errors {
  double before = 0, after = 0, nees = 0;  // RMSE of the rotation, rad; normalised squared error over 6
};
Errors errors(const std::vector<FlexMeasurement>& measurements, const FlexResult& r, double frequency) {
  Errors e;
  const double n = static_cast<double>(measurements.size());
  for (size_t i = 0; i < measurements.size(); ++i) {
    const SE3 truth = swing(measurements[i].time, frequency);
    e.before += std::pow((measurements[i].T_rl.inverse() * truth).angle(), 2) / n;
    const Vector6d xi = (r.states[i].T_rl.inverse() * truth).log();
    e.after += xi.tail<3>().squaredNorm() / n;
    e.nees += xi.dot(r.states[i].covariance.ldlt().solve(xi)) / 6 / n;
  }
  return {std::sqrt(e.before), std::sqrt(e.after), e.nees};
}

TEST(Flex, NothingOfTheMotionIsSmoothedAway) {
  for (const double frequency : {1.0, 2.0, 4.0, 8.0}) {
    const auto m = series(frequency, 30, 5e-4, 1e-3);
    const FlexResult r = smooth_flex(m);
    ASSERT_TRUE(r.usable);
    const Errors e = errors(m, r, frequency);
    EXPECT_LT(e.after, 1.02 * e.before) << frequency;
    EXPECT_LT(e.nees, 1.3) << frequency;
    EXPECT_GT(e.nees, 0.5) << frequency;
    EXPECT_LT((r.mean.inverse() * kRest).log().norm(), 0.02) << frequency;
  }
}

TEST(Flex, ASlowMotionThatIsStatedAsSuchIsSmoothed) {
  const auto m = series(0.5, 30, 5e-3, 5e-3);
  FlexOptions options;
  options.frequency = 0.5;
  const FlexResult r = smooth_flex(m, options);
  ASSERT_TRUE(r.usable);
  const Errors e = errors(m, r, 0.5);
  EXPECT_LT(e.after, 0.6 * e.before);
  EXPECT_LT(e.nees, 1.4);
}

TEST(Flex, GapsAreFilledAndOutliersDoNotBend) {
  auto m = series(1, 30, 5e-4, 1e-3);
  m[20].valid = m[21].valid = false;
  Vector6d wrong = Vector6d::Zero();
  wrong[4] = 0.3;
  m[40].T_rl = m[40].T_rl * SE3::exp(wrong);
  FlexOptions options;
  options.frequency = 1;
  const FlexResult r = smooth_flex(m, options);
  ASSERT_TRUE(r.usable);
  ASSERT_EQ(r.states.size(), m.size());
  for (const size_t i : {size_t{20}, size_t{21}, size_t{40}})
    EXPECT_LT((r.states[i].T_rl.inverse() * swing(m[i].time, 1)).angle(), 0.01) << i;
  EXPECT_GT(r.states[21].covariance(5, 5), 4 * r.states[30].covariance(5, 5));
}

TEST(Flex, CovariancesOfAChainAreBlocksOfTheInverse) {
  constexpr int kLinks = 5;
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 1);
  std::vector<internal::ChainLink> links(kLinks);
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(kLinks * 30, kLinks * 12);
  for (int i = 0; i < kLinks; ++i) {
    internal::ChainLink& link = links[static_cast<size_t>(i)];
    link.own =
        Eigen::MatrixXd::NullaryExpr(i == 2 ? 0 : 18, 12, [&] { return normal(random); });  // one by its neighbours alone
    J.block(30 * i, 12 * i, link.own.rows(), 12) = link.own;
    if (i + 1 == kLinks) continue;
    for (internal::Matrix12d* block : {&link.to_next, &link.next})
      *block = internal::Matrix12d::NullaryExpr([&] { return 10 * normal(random); });
    J.block<12, 12>(30 * i + 18, 12 * i) = link.to_next;
    J.block<12, 12>(30 * i + 18, 12 * (i + 1)) = link.next;
  }
  const Eigen::MatrixXd inverse = (J.transpose() * J).inverse();
  const auto covariances = internal::chain_covariances(links);
  ASSERT_EQ(covariances.size(), size_t{kLinks});
  for (int i = 0; i < kLinks; ++i) {
    const Eigen::MatrixXd expected = inverse.block(12 * i, 12 * i, 12, 12);
    EXPECT_LT((covariances[static_cast<size_t>(i)] - expected).norm(), 1e-9 * expected.norm()) << i;
  }
}

TEST(Flex, TakesTimeInProportion) {
  const auto seconds = [](int moments) {
    const auto m = series(1, 30, 5e-4, 1e-3, 1, moments);
    const std::clock_t start = std::clock();  // of this process, however busy the machine
    EXPECT_TRUE(smooth_flex(m).usable);
    return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  };
  const double few = seconds(400), many = seconds(1600);
  EXPECT_LT(many, 8 * few);
}

TEST(CommonPose, OfManyVotesIsThatOfMostOfThem) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 1);
  const auto xi_of = [&](double sigma) { return Vector6d(Vector6d::NullaryExpr([&] { return sigma * normal(random); })); };
  std::vector<internal::PoseVote> votes;
  for (int i = 0; i < 1000; ++i)
    votes.push_back({i % 5 < 2 ? SE3::exp(xi_of(0.5)) : kRest * SE3::exp(xi_of(1e-3)), 1e-6 * Matrix6d::Identity(), 0, 0});
  std::vector<internal::PoseVote> again = votes;
  const SE3 T = internal::common_pose(votes);
  EXPECT_LT((kRest.inverse() * T).log().norm(), 3e-4);
  EXPECT_EQ(T.matrix(), common_pose(again).matrix());
}

TEST(Flex, WhatCannotBeIsRefused) {
  auto m = series(1, 30, 5e-4, 1e-3);
  EXPECT_FALSE(smooth_flex({}).usable);
  for (const double FlexOptions::*option : {&FlexOptions::rotation, &FlexOptions::translation, &FlexOptions::frequency}) {
    FlexOptions options;
    const_cast<double&>(options.*option) = std::numeric_limits<double>::quiet_NaN();
    EXPECT_THROW(smooth_flex(m, options), Error);
  }
  auto bad = m;
  bad[3].time = bad[2].time;
  EXPECT_THROW(smooth_flex(bad), Error);
  bad = m;
  bad[3].covariance.setZero();
  EXPECT_THROW(smooth_flex(bad), Error);
  bad[3].valid = false;
  EXPECT_TRUE(smooth_flex(bad).usable);
  for (FlexMeasurement& x : bad) x.valid = false;
  EXPECT_FALSE(smooth_flex(bad).usable);
}

}  // namespace
}  // namespace iclk
