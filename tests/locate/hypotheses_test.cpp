// The poses that a search compares lie close enough to any pose that the prior allows.
#include <random>

#include <gtest/gtest.h>
#include <iclk/locate/internal/hypotheses.h>

#include "../apps/render_fixture.h"

namespace iclk {
namespace {

const Camera kCamera{580, 580, 319.5, 239.5, 640, 480};
constexpr double kDistance = 60;
const double kSide = kDistance * 480 / 580;  // m, the shorter side of the picture on the ground

/// Some hypothesis is within half a step of the shift and the heading.
bool covered(const std::vector<SE3>& poses, const Eigen::Vector3d& at, double heading) {
  return std::any_of(poses.begin(), poses.end(), [&](const SE3& pose) {
    const Eigen::Vector3d off = pose.t - at;
    const double turned = (test::looking_down(at, heading).R.transpose() * pose.R).trace();
    return std::max(std::abs(off.x()), std::abs(off.y())) <= 0.25 * kSide + 1e-9 && std::abs(off.z()) <= 0.13 * kDistance &&
           std::acos(std::clamp((turned - 1) / 2, -1.0, 1.0)) <= M_PI / 12 + 1e-6;
  });
}

TEST(Hypotheses, CoverThePrior) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  LocatePrior prior{test::looking_down({500, 300, kDistance}, 0.3), 15, 5, 0, 0.2};
  for (const bool heading_known : {true, false}) {
    if (!heading_known) prior.heading_sigma = M_PI;
    const auto poses = internal::hypotheses(prior, kCamera, kDistance, 2);
    for (int i = 0; i < 500; ++i) {
      const double angle = M_PI * uniform(random), out = 30 * std::abs(uniform(random));
      const Eigen::Vector3d at(500 + out * std::cos(angle), 300 + out * std::sin(angle), kDistance + 10 * uniform(random));
      const double heading = 0.3 + (heading_known ? 0.4 : M_PI) * uniform(random);
      EXPECT_TRUE(covered(poses, at, heading)) << at.transpose() << " heading " << heading;
    }
    EXPECT_LT(poses.size(), heading_known ? 250u : 1500u);
  }
}

TEST(Hypotheses, BeginAtThePrior) {
  const LocatePrior prior{test::looking_down({500, 300, kDistance}), 15, 5, 0.05, 0.2};
  const auto poses = internal::hypotheses(prior, kCamera, kDistance, 2);
  EXPECT_EQ(poses.front().matrix(), prior.T_WC.matrix());
  EXPECT_LT((poses[5].t - prior.T_WC.t).norm(), (poses.back().t - prior.T_WC.t).norm());
}

TEST(Hypotheses, AnExactPriorIsOnePose) {
  const LocatePrior prior{test::looking_down({500, 300, kDistance}), 0, 0, 0, 0};
  EXPECT_EQ(internal::hypotheses(prior, kCamera, kDistance, 2).size(), 1u);
}

}  // namespace
}  // namespace iclk
