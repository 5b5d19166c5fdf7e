// What a level knows of the pose and the next finer one keeps (AlignerOptions::carry).
#include <cmath>
#include <random>
#include <vector>

#include <Eigen/Dense>

#include <iclk/align/solver/lm.h>

#include "solvers.h"

namespace iclk::test {
namespace {

using internal::LmIteration;
using internal::NormalSums;

/// A level whose cost is (x - optimum)^T H (x - optimum) + noise, x the translation: rotations are held where they are.
struct Quadratic {
  Eigen::Vector3d optimum;
  Eigen::Matrix3d H;
  double variance;  // of a residual, at the optimum

  NormalSums at(const SE3& T_10) const {
    const Eigen::Vector3d off = T_10.t - optimum;
    NormalSums sums;
    sums.H.topLeftCorner<3, 3>() = H;
    sums.H.block<3, 3>(3, 3).setIdentity();
    sums.H(6, 6) = 1;
    sums.H(7, 7) = sums.visible = sums.masked = 1e6;
    sums.g.head<3>() = H * off;
    sums.cost = variance * sums.weight() + off.dot(H * off);
    return sums;
  }
};

SE3 descend(const AlignerOptions& options, std::initializer_list<Quadratic> levels, const PosePrior* prior = nullptr) {
  LmIteration lm({&options, prior, 1}, {});
  for (const Quadratic& level : levels) {
    lm.begin_level({100, 100, 50, 50, 100, 100});
    for (int i = 0; i < options.iterations; ++i) lm.step(level.at(lm.point().T_10));
    lm.end_level(level.at(lm.point().T_10));
  }
  return lm.point().T_10;
}

// Three levels that disagree, and a prior: where each ends is the mean of what it was told and what it sees, by their
// information, and it tells that on, with a share of what it saw as the information.
TEST(Carry, EachLevelEndsAtTheMeanByInformation) {
  const Eigen::Vector3d a(0.01, 0.02, -0.01), b(0.03, -0.01, 0.02), c(-0.02, 0.01, 0.03), p(0.02, 0.02, 0.02);
  Eigen::Matrix3d A = Eigen::Vector3d(3, 5, 2).asDiagonal(), B = Eigen::Vector3d(9, 4, 7).asDiagonal(), C = 6 * A;
  A(0, 1) = A(1, 0) = 1.5;
  B(1, 2) = B(2, 1) = -2;
  const Quadratic coarse{a, A, 0.01}, middle{b, B, 0.02}, fine{c, C, 0.05};
  PosePrior prior{SE3{Eigen::Matrix3d::Identity(), p}, Matrix6d::Zero()};
  prior.information.topLeftCorner<3, 3>() = Eigen::Vector3d(40, 80, 20).asDiagonal();
  for (Damping damping : {Damping::fixed, Damping::adaptive})
    for (double carry : {0.0, 0.25, 1.0})
      for (bool has_prior : {false, true}) {
        AlignerOptions options;
        options.photometric = false;
        options.damping = damping;
        options.carry = carry;
        options.residual_sigma = std::sqrt(fine.variance);  // what a prior is weighed against without carry
        Eigen::Matrix3d told = Eigen::Matrix3d::Zero();
        if (has_prior) told = prior.information.topLeftCorner<3, 3>();
        Eigen::Vector3d expected = p;
        const std::vector<Quadratic> that_count = carry > 0 ? std::vector{coarse, middle, fine} : std::vector{fine};
        for (const Quadratic& level : that_count) {
          const Eigen::Matrix3d seen = level.H / level.variance;
          expected = (told + seen).ldlt().solve(told * expected + seen * level.optimum);
          told += carry * seen;
        }
        const SE3 T = descend(options, {coarse, middle, fine}, has_prior ? &prior : nullptr);
        EXPECT_LT((T.t - expected).norm(), 2e-4)
            << carry << (has_prior ? ", prior: " : ": ") << T.t.transpose() << " for " << expected.transpose();
      }
}

TEST(Carry, ALevelThatFoundNothingLeavesNothing) {
  AlignerOptions options;
  options.photometric = false;
  options.carry = 1;
  const Quadratic fine{{0.01, 0.02, 0.03}, Eigen::Matrix3d::Identity(), 0.01};
  const Quadratic nothing{{9, 9, 9}, Eigen::Matrix3d::Zero(), 0.01};
  EXPECT_LT((descend(options, {nothing, fine}).t - fine.optimum).norm(), 1e-6);
  const Quadratic broken{{9, 9, 9}, Eigen::Matrix3d::Constant(NAN), 0.01};
  EXPECT_LT((descend(options, {broken, fine}).t - fine.optimum).norm(), 1e-6);
}

class CarryPose : public Solvers {};

// Noise that the coarse levels average away and the finest drowns in.
TEST_P(CarryPose, FinestLevelsInNoiseDoNotDecideAlone) {
  double without = 0, with = 0;
  for (int seed = 0; seed < 4; ++seed) {
    const Relief scene = moved_relief();
    const Features features = random_features(scene, 50);
    Frame image0 = render(scene, 0), image1 = render(scene, 1);
    std::mt19937 random(static_cast<unsigned>(seed));
    std::normal_distribution<float> noise(0, 0.35f);
    for (Frame* image : {&image0, &image1})
      for (int v = 0; v < scene.camera.height; ++v)
        for (int u = 0; u < scene.camera.width; ++u) image->at(u, v) += noise(random);
    AlignerOptions options;
    options.robust = Robust::unit;
    options.photometric = false;
    without += pixel_error(scene, features, align_once(way(), scene, image0, image1, features, options).T_10) / 4;
    options.carry = 1;
    with += pixel_error(scene, features, align_once(way(), scene, image0, image1, features, options).T_10) / 4;
  }
  EXPECT_LT(with, 0.75 * without);
  RecordProperty("without", std::to_string(without));
  RecordProperty("with", std::to_string(with));
}

TEST_P(CarryPose, CleanImagesComeOutAsWell) {
  const Relief scene = moved_relief();
  const Features features = random_features(scene, 50);
  AlignerOptions options;
  options.carry = 0.1;
  const Alignment a = align_once(way(), scene, render(scene, 0), render(scene, 1), features, options);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_LT(pixel_error(scene, features, a.T_10), 0.02);
}

INSTANTIATE_TEST_SUITE_P(All, CarryPose, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

// Every solver ends at the same pose, with a prior and without.
TEST(Carry, AllSolversAgree) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.noise = 0.05;
  Vector6d xi, elsewhere;
  xi << 0.06, -0.05, 0.12, 0.012, 0.015, -0.03;
  elsewhere << -0.02, 0.03, 0.01, 0.004, -0.006, 0.01;
  scene.T_10 = SE3::exp(xi);
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const PosePrior prior{SE3::exp(elsewhere), 3e5 * Matrix6d::Identity()};
  for (Damping damping : {Damping::fixed, Damping::adaptive})
    for (bool photometric : {false, true})
      for (bool has_prior : {false, true}) {
        AlignerOptions options;
        options.damping = damping;
        options.photometric = photometric;
        const std::optional<PosePrior> given = has_prior ? std::optional(prior) : std::nullopt;
        const Alignment alone = align_once(Way::cpu, scene, image0, image1, features, options, {}, given);
        options.carry = 0.7;
        const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, options, {}, given);
        EXPECT_GT(distance(alone.T_10, expected.T_10, scene.distance), 1e-4) << "it makes a difference";
        for (Way way : {Way::host, Way::device, Way::split}) {
          const Alignment a = align_once(way, scene, image0, image1, features, options, {}, given);
          SCOPED_TRACE(std::string(name(way)) + (has_prior ? ", prior" : "") + (photometric ? ", photometric" : ""));
          EXPECT_LT(distance(a.T_10, expected.T_10, scene.distance), 1e-5);
          EXPECT_EQ(a.status, expected.status) << a.reason;
        }
      }
}

}  // namespace
}  // namespace iclk::test
