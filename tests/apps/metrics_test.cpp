#include <iclk/session/pose_errors.h>

#include <gtest/gtest.h>

#include <cmath>

namespace iclk {
namespace {

const Camera kCamera{100, 200, 50, 60, 100, 120};

Features two_features() {
  Features f;
  f.uv = {{50, 60}, {60, 60}};  // on the axis and 0.1 to its right, at 2 m and 4 m
  f.inverse_depth = {0.5, 0.25};
  return f;
}

TEST(Metrics, TranslationByHand) {
  // Estimate 0.02 m to the right of the truth: 100 * 0.02 / 2 = 1 px and 100 * 0.02 / 4 = 0.5 px.
  const SE3 truth, estimate{Eigen::Matrix3d::Identity(), {0.02, 0, 0}};
  const PoseError e = pose_error(kCamera, two_features(), estimate, truth);
  EXPECT_NEAR(e.e_pixel, 0.75, 1e-12);
  EXPECT_NEAR(e.e_transl, 0.02, 1e-15);
  EXPECT_NEAR(e.e_rot, 0, 1e-9);
}

TEST(Metrics, RotationByHand) {
  Vector6d xi = Vector6d::Zero();
  xi[5] = 0.1;  // about the optical axis: the feature on it stays, the other moves on an ellipse
  const PoseError e = pose_error(kCamera, two_features(), SE3::exp(xi), SE3());
  const double du = 10 * (std::cos(0.1) - 1), dv = 2 * 10 * std::sin(0.1);
  EXPECT_NEAR(e.e_pixel, std::hypot(du, dv) / 2, 1e-9);
  EXPECT_NEAR(e.e_rot, 0.1, 1e-12);
  EXPECT_EQ(e.e_transl, 0);
  EXPECT_NEAR(pose_error(kCamera, two_features(), SE3::exp(4 * xi), SE3::exp(3 * xi)).e_rot, 0.1, 1e-9)
      << "between the two, not their sum";
}

TEST(Metrics, TheErrorIsOfT10NotOfItsInverse) {
  // Camera 1 looks back: R = 180 degrees about y. |t - t_true| of T_10 is 0.3, of the camera centres too, but in other
  // directions.
  const SE3 truth{Eigen::Vector3d(-1, 1, -1).asDiagonal(), {0, 0, 4}};
  const SE3 estimate{Eigen::Vector3d(-1, 1, -1).asDiagonal(), {0, 0, 4.3}};
  EXPECT_NEAR(pose_error(kCamera, two_features(), estimate, truth).e_transl, 0.3, 1e-12);
}

TEST(Metrics, FeaturesWithoutPositionDoNotCount) {
  Features f = two_features();
  f.uv.push_back({10, 10});
  f.inverse_depth.push_back(0);  // no depth
  f.uv.push_back({10, 10});
  f.inverse_depth.push_back(NAN);
  f.uv.push_back({10, 10});
  f.inverse_depth.push_back(10);  // at 0.1 m, behind a camera that moved forward by 0.2
  const SE3 forward{Eigen::Matrix3d::Identity(), {0, 0, -0.2}};
  const PoseError e = pose_error(kCamera, f, forward, SE3());
  EXPECT_NEAR(e.e_pixel, (0 + 100 * 0.4 * (1 / 3.8 - 1 / 4.0)) / 2, 1e-9);
  const PoseError none = pose_error(kCamera, {}, SE3(), SE3());
  EXPECT_TRUE(std::isnan(none.e_pixel));
}

TEST(Metrics, AlignedFeaturesAgainstTheTruth) {
  std::vector<AlignedFeature> aligned(2);
  aligned[0].uv1 = {53, 64};  // 5 px from (50, 60)
  aligned[0].status = FeatureStatus::aligned;
  aligned[1].uv1 = {0, 0};
  aligned[1].status = FeatureStatus::bad_match;
  EXPECT_NEAR(aligned_error(kCamera, two_features(), aligned, SE3()), 5, 1e-12);
  EXPECT_TRUE(std::isnan(aligned_error(kCamera, two_features(), {}, SE3())));
}

}  // namespace
}  // namespace iclk
