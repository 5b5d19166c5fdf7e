// The CPU reference against the executable specification, stage by stage.
#include <gtest/gtest.h>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/solver/jacobian.h>
#include <iclk/align/solver/mask.h>
#include <iclk/align/solver/normal_equations.h>
#include <iclk/shaders/shared.h>

#include "golden.h"

namespace iclk {
namespace {

using test::Golden;

class ParityCpu : public testing::TestWithParam<const char*> {
 protected:
  ParityCpu() : golden(GetParam()), camera(golden.camera()), features(golden.features()) {
    checks = check_features(features, camera);
    rgb0 = golden.rgb("image0");
    rgb1 = golden.rgb("image1");
    f0 = grey_pyramid(golden.view(rgb0), 4);
    f1 = grey_pyramid(golden.view(rgb1), 4);
  }

  internal::Template level_template(int level) const {
    const auto mask = internal::sparse_mask(features, checks, camera, level);
    return internal::sparse_template(f0[level], features, mask, level);
  }
  // The pose with which a level starts: the last of the next coarser one.
  SE3 start(int level) const {
    if (level == 3) return {};
    const auto &R = golden.level(level + 1, "R").data, &t = golden.level(level + 1, "t").data;
    return Golden::pose(R.data() + 9 * 9, t.data() + 9 * 3);
  }

  Golden golden;
  Camera camera;
  Features features;
  std::vector<FeatureCheck> checks;
  std::vector<float> rgb0, rgb1;
  Pyramid f0, f1;
};

TEST_P(ParityCpu, Pyramid) {
  for (int level = 0; level < 4; ++level)
    for (const auto* side : {&f0, &f1}) {
      const auto& expected = golden.level(level, side == &f0 ? "f0" : "f1");
      const Map& map = (*side)[level];
      ASSERT_EQ(map.height, static_cast<int>(expected.shape[2]));
      ASSERT_EQ(map.width, static_cast<int>(expected.shape[3]));
      for (size_t i = 0; i < map.data.size(); ++i) ASSERT_NEAR(map.data[i], expected.data[i], 1e-6) << "level " << level;
    }
}

TEST_P(ParityCpu, Mask) {
  for (int level = 0; level < 4; ++level) {
    const auto& expected = golden.level(level, "inverse_depth_mask").data;
    std::vector<float> dense(expected.size(), 0.0f);
    int covered_twice = 0;
    for (const auto& p : level_template(level)) {
      if (p.inverse_depth == 0) continue;
      float& q = dense[static_cast<size_t>(p.v) * f0[level].width + static_cast<size_t>(p.u)];
      covered_twice += q != 0;
      q = p.inverse_depth;
    }
    EXPECT_EQ(covered_twice, 0);
    for (size_t i = 0; i < dense.size(); ++i)
      ASSERT_NEAR(dense[i], expected[i], 1e-5 * expected[i]) << "level " << level << " pixel " << i;
  }
}

TEST_P(ParityCpu, Residual) {
  for (int level = 0; level < 4; ++level) {
    const auto& expected = golden.level(level, "residual_start").data;
    const auto pixels = level_template(level);
    const auto r = internal::residuals(pixels, f1[level], camera.at_level(level), {start(level), 1, 0});
    std::vector<float> dense(expected.size(), 0.0f);
    for (size_t k = 0; k < r.size(); ++k)
      if (std::isfinite(r[k]))
        dense[static_cast<size_t>(pixels[k].v) * f0[level].width + static_cast<size_t>(pixels[k].u)] = r[k];
    for (size_t i = 0; i < dense.size(); ++i) ASSERT_NEAR(dense[i], expected[i], 1e-5) << "level " << level << " pixel " << i;
  }
}

TEST_P(ParityCpu, NormalEquations) {
  for (int level = 0; level < 4; ++level) {
    const auto sums =
        internal::normal_equations(level_template(level), f1[level], camera.at_level(level), {start(level), 1, 0}, {});
    const auto &H = golden.level(level, "H_first").data, &g = golden.level(level, "g_first").data;
    double g_norm = 0;
    for (float x : g) g_norm = std::max(g_norm, std::abs(static_cast<double>(x)));
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j)
        EXPECT_NEAR(sums.H(i, j), H[6 * i + j], 1e-5 * std::sqrt(H[7 * i] * H[7 * j])) << "level " << level << " H " << i << j;
      // g sums terms of both signs: its error is measured against its Cauchy-Schwarz bound.
      EXPECT_NEAR(sums.g(i), g[i], 1e-5 * std::sqrt(H[7 * i] * sums.cost)) << "level " << level << " g " << i;
    }
  }
}

TEST_P(ParityCpu, EveryIteration) {
  Plan plan{golden.width(), golden.height()};
  plan.max_features = features.size();
  CpuAligner aligner(plan, Golden::paper_options());
  aligner.set_reference(0, {golden.view(rgb0), camera, features, {}});
  const Alignment a = aligner.align(Pair{0, golden.view(rgb1), {}, {}});
  const double motion = golden.truth().t.norm();
  ASSERT_EQ(a.levels.size(), 4u);
  for (const LevelTrace& trace : a.levels) {
    ASSERT_EQ(trace.iterations.size(), 10u);
    for (size_t i = 0; i < 10; ++i) {
      const SE3 expected =
          Golden::pose(&golden.level(trace.level, "R").data[9 * i], &golden.level(trace.level, "t").data[3 * i]);
      EXPECT_LT((trace.iterations[i].T_10.t - expected.t).norm(), 1e-4 * motion)
          << "level " << trace.level << " iteration " << i;
      EXPECT_LT((trace.iterations[i].T_10.R - expected.R).norm(), 1e-5) << "level " << trace.level << " iteration " << i;
    }
  }
  EXPECT_LT((a.T_10.t - golden.result().t).norm(), 1e-5 * motion);
  EXPECT_LT((a.T_10.R - golden.result().R).norm(), 1e-6);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
}

INSTANTIATE_TEST_SUITE_P(Golden, ParityCpu, testing::Values("classical_188x120", "classical_odd_203x151"));

}  // namespace
}  // namespace iclk
