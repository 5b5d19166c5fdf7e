#include "apps/eval/metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include <Eigen/Cholesky>

namespace iclk {
namespace {

EvalSample sample(double start, double end, bool found = true, bool claimed = true, double nees = NAN) {
  EvalSample s;
  s.start = {start, start / 10, start / 100};
  s.stages = {{"initial", s.start, true}};
  const PoseError error = found ? PoseError{end, end / 10, end / 100} : s.start;
  s.stages.push_back({"pose", error, found});
  s.found = found;
  s.claimed = claimed;
  s.nees = nees;
  s.ms = 2 * end;
  return s;
}

TEST(EvalMetrics, PercentilesAreNumpys) {
  EXPECT_EQ(percentile({4, 1, 3, 2}, 50), 2.5);
  EXPECT_DOUBLE_EQ(percentile({4, 1, 3, 2}, 95), 3.85);
  EXPECT_EQ(percentile({1, 2, 3}, 100), 3);
  EXPECT_EQ(percentile({7}, 95), 7);
  EXPECT_TRUE(std::isnan(percentile({}, 50)));
  const Spread3 s = spread3({1, 2, 9});
  EXPECT_EQ(s.mean, 4);
  EXPECT_EQ(s.median, 2);
  EXPECT_DOUBLE_EQ(s.p95, 2 + 0.9 * 7);
}

TEST(EvalMetrics, RowsByHand) {
  // Four pairs: 0.5 px, 2 px, 7 px, and one without a pose whose start was 0.8 px.
  const std::vector<EvalSample> samples = {sample(10, 0.5), sample(20, 2), sample(30, 7), sample(0.8, 99, false, false)};
  const std::vector<StageRow> rows = stage_rows(samples);
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows[0].stage, "initial");
  EXPECT_DOUBLE_EQ(rows[0].e_pixel.mean, 60.8 / 4);
  EXPECT_EQ(rows[0].within_1px, 0.25) << "a start needs nobody to find it";
  const StageRow& end = rows[1];
  EXPECT_EQ(end.pairs, 4);
  EXPECT_EQ(end.ran, 3);
  EXPECT_DOUBLE_EQ(end.e_pixel.mean, (0.5 + 2 + 7 + 0.8) / 4) << "without a pose the start's error is left";
  EXPECT_DOUBLE_EQ(end.e_pixel.median, (0.8 + 2) / 2);
  EXPECT_DOUBLE_EQ(end.e_pixel.p95, 2 + 0.85 * 5);
  EXPECT_DOUBLE_EQ(end.e_transl.mean, end.e_pixel.mean / 10);
  EXPECT_DOUBLE_EQ(end.e_rot.mean, end.e_pixel.mean / 100);
  EXPECT_EQ(end.within_1px, 0.25) << "a pair without a pose is never within 1 px, whatever its start";
  EXPECT_EQ(end.within_3px, 0.5);
  EXPECT_TRUE(stage_rows({}).empty());
}

TEST(EvalMetrics, ClaimsByHand) {
  const std::vector<EvalSample> samples = {sample(10, 0.5, true, true, 4), sample(20, 2, true, true, 20),
                                           sample(30, 7, true, true, 600), sample(5, 9, true, false, 3),
                                           sample(8, 0.1, true, true)};
  const ClaimRow row = claim_row(samples);
  EXPECT_EQ(row.pairs, 5);
  EXPECT_EQ(row.claimed, 4);
  EXPECT_EQ(row.wrong, 1) << "7 px and said converged; 9 px said so";
  EXPECT_DOUBLE_EQ(row.e_pixel, (0.5 + 2) / 2);
  EXPECT_EQ(row.with_covariance, 3);
  EXPECT_DOUBLE_EQ(row.nees, 208);
  EXPECT_EQ(row.nees_median, 20);
  EXPECT_DOUBLE_EQ(row.inside_95, 1 / 3.0) << "only 4 lies below 12.59";
  EXPECT_EQ(row.ms, 4);
  EXPECT_TRUE(std::isnan(claim_row({}).e_pixel));
}

TEST(EvalMetrics, TheNormalisedErrorIsInTheTwistOfTheCovariance) {
  Vector6d xi, at, sigma;
  at << 0.4, -2, 1, 0.5, -0.9, 0.3;  // far from the identity: the twist of the other side is another one
  xi << 0.01, 0.02, -0.03, 0.001, -0.002, 0.004;
  sigma << 0.01, 0.01, 0.01, 0.002, 0.002, 0.002;
  const SE3 mean = SE3::exp(at), truth = mean * SE3::exp(xi);
  const Matrix6d C = sigma.cwiseAbs2().asDiagonal();
  EXPECT_NEAR(normalised_error(mean, C, truth), 1 + 4 + 9 + 0.25 + 1 + 4, 1e-9);
  EXPECT_TRUE(std::isnan(normalised_error(mean, Matrix6d::Zero(), truth)));
  EXPECT_TRUE(std::isnan(normalised_error(mean, Matrix6d::Constant(NAN), truth)));
}

TEST(EvalMetrics, ErrorsDrawnFromTheCovarianceGiveSix) {
  std::mt19937 generator(1);
  std::normal_distribution<double> normal;
  const Matrix6d A = Matrix6d::NullaryExpr([&](Eigen::Index, Eigen::Index) { return 0.01 * normal(generator); });
  const Matrix6d C = A * A.transpose() + 1e-6 * Matrix6d::Identity();
  const Matrix6d L = C.llt().matrixL();
  std::vector<EvalSample> samples;
  for (int i = 0; i < 4000; ++i) {
    const Vector6d xi = L * Vector6d::NullaryExpr([&](Eigen::Index) { return normal(generator); });
    Vector6d at;
    at << 1, 2, 3, 0.1, 0.2, 0.3;
    samples.push_back(sample(9, 0.1, true, true, normalised_error(SE3::exp(at), C, SE3::exp(at) * SE3::exp(xi))));
  }
  const ClaimRow row = claim_row(samples);
  EXPECT_NEAR(row.nees, 6, 0.25);
  EXPECT_NEAR(row.nees_median, 5.35, 0.25);
  EXPECT_NEAR(row.inside_95, 0.95, 0.015);
}

TEST(EvalMetrics, BasinsAreBinsOfEquallyMany) {
  std::vector<EvalSample> samples;
  for (int i = 0; i < 20; ++i) samples.push_back(sample(20 - i, 20 - i <= 10 ? 0.2 : 8));  // starts of 1 to 20 px
  samples[12].found = false;                                                               // its start: 8 px
  const std::vector<BasinBin> bins = basin(samples, &PoseError::e_pixel, 4, 1);
  ASSERT_EQ(bins.size(), 4u);
  EXPECT_EQ(bins[0].pairs, 5);
  EXPECT_EQ(bins[0].from, 1);
  EXPECT_EQ(bins[0].to, 5);
  EXPECT_EQ(bins[0].centre, 3);
  EXPECT_EQ(bins[0].success, 1);
  EXPECT_EQ(bins[1].success, 0.8) << "one without a pose";
  EXPECT_EQ(bins[2].success, 0);
  EXPECT_EQ(basin(samples, &PoseError::e_rot, 4, 1)[0].to, 0.05);
  EXPECT_EQ(basin(std::span(samples).first(7), &PoseError::e_pixel, 4, 1).size(), 1u) << "a bin has five at least";
  EXPECT_TRUE(basin({}, &PoseError::e_pixel, 4, 1).empty());
}

}  // namespace
}  // namespace iclk
