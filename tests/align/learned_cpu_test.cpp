// The learned model on the CPU against the executable specification, stage by stage.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/network/m_estimator.h>
#include <iclk/align/network/network.h>
#include <iclk/align/solver/jacobian.h>
#include <iclk/align/solver/mask.h>
#include <iclk/align/solver/normal_equations.h>
#include <iclk/engine/error.h>

#include "learned_golden.h"

namespace iclk {
namespace {

using test::Golden;

double largest(const std::vector<float>& values) {
  double out = 0;
  for (const float x : values) out = std::max(out, std::abs(static_cast<double>(x)));
  return out;
}

class LearnedCpu : public testing::TestWithParam<const char*> {
 protected:
  LearnedCpu() : golden(GetParam()), camera(golden.camera()), features(golden.features()), model(test::golden_model(golden)) {
    checks = check_features(features, camera);
    rgb0 = golden.rgb("image0");
    rgb1 = golden.rgb("image1");
  }

  /// A map of the specification: stages are compared one by one, each from exact input.
  Map exact(int level, const std::string& key) const {
    const auto& tensor = golden.level(level, key);
    Map map(static_cast<int>(tensor.shape[3]), static_cast<int>(tensor.shape[2]));
    map.data = tensor.data;
    return map;
  }
  internal::Template level_template(int level) const {
    const auto mask = internal::sparse_mask(features, checks, camera, level);
    return internal::sparse_template(exact(level, "f0"), features, mask, level);
  }
  SE3 start(int level) const {
    if (level == model.levels() - 1) return {};
    const auto &R = golden.level(level + 1, "R").data, &t = golden.level(level + 1, "t").data;
    return Golden::pose(R.data() + 9 * 9, t.data() + 9 * 3);
  }

  Golden golden;
  Camera camera;
  Features features;
  Model model;
  std::vector<FeatureCheck> checks;
  std::vector<float> rgb0, rgb1;
};

TEST_P(LearnedCpu, Maps) {
  for (const bool first : {true, false}) {
    const Pyramid maps = internal::encode(model, golden.view(first ? rgb0 : rgb1), model.levels());
    ASSERT_EQ(static_cast<int>(maps.size()), model.levels());
    for (int level = 0; level < model.levels(); ++level) {
      const Map expected = exact(level, first ? "f0" : "f1");
      const Map& map = maps[static_cast<size_t>(level)];
      ASSERT_EQ(map.width, expected.width);
      ASSERT_EQ(map.height, expected.height);
      const double bound = 1e-5 * largest(expected.data);
      for (size_t i = 0; i < map.data.size(); ++i)
        ASSERT_NEAR(map.data[i], expected.data[i], bound) << "level " << level << " pixel " << i;
    }
  }
}

TEST_P(LearnedCpu, Weights) {
  Map weight;
  for (int level = model.levels() - 1; level >= 0; --level) {
    const auto pixels = level_template(level);
    const auto weights =
        internal::m_estimator_weights(model, pixels, exact(level, "f1"), camera.at_level(level), {start(level), 1, 0}, weight);
    const Map expected = exact(level, "weight");
    ASSERT_GT(largest(expected.data), 0);
    for (size_t i = 0; i < expected.data.size(); ++i)
      ASSERT_NEAR(weight.data[i], expected.data[i], 1e-5) << "level " << level << " pixel " << i;
    for (size_t k = 0; k < pixels.size(); ++k) {
      const internal::TemplatePixel& p = pixels[k];
      ASSERT_EQ(weights[k], p.inverse_depth > 0 ? weight.at(static_cast<int>(p.u), static_cast<int>(p.v)) : 0);
    }
  }
}

TEST_P(LearnedCpu, NormalEquations) {
  for (int level = 0; level < model.levels(); ++level) {
    const auto pixels = level_template(level);
    const Map weight = exact(level, "weight");
    std::vector<float> weights;
    for (const auto& p : pixels) weights.push_back(weight.at(static_cast<int>(p.u), static_cast<int>(p.v)));
    const auto sums =
        internal::normal_equations(pixels, exact(level, "f1"), camera.at_level(level), {start(level), 1, 0}, weights);
    const double rounding = 1e-7 * largest(exact(level, "f0").data);  // of the maps as they are stored, in a residual
    const auto &H = golden.level(level, "H_first").data, &g = golden.level(level, "g_first").data;
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j)
        EXPECT_NEAR(sums.H(i, j), H[6 * i + j], 1e-4 * std::sqrt(H[7 * i] * H[7 * j])) << "level " << level << " H " << i << j;
      const double bound = 1e-4 * std::sqrt(sums.cost) + rounding * std::sqrt(sums.weight());
      EXPECT_NEAR(sums.g(i), g[i], std::sqrt(H[7 * i]) * bound) << "level " << level << " g " << i;
    }
  }
}

TEST_P(LearnedCpu, EveryIteration) {
  Plan plan{golden.width(), golden.height()};
  plan.max_features = features.size();
  CpuAligner aligner(plan, test::golden_options(model), std::make_shared<Model>(model));
  aligner.set_reference(0, {golden.view(rgb0), camera, features, {}});
  const Alignment a = aligner.align(Pair{0, golden.view(rgb1), {}, {}});
  // Random weights need not converge, so the last levels may amplify what is rounded; motion is what the specification moved.
  const double motion = golden.result().t.norm();
  ASSERT_EQ(static_cast<int>(a.levels.size()), model.levels());
  for (const LevelTrace& trace : a.levels) {
    ASSERT_EQ(trace.iterations.size(), 10u);
    for (size_t i = 0; i < 10; ++i) {
      const SE3 expected =
          Golden::pose(&golden.level(trace.level, "R").data[9 * i], &golden.level(trace.level, "t").data[3 * i]);
      EXPECT_LT((trace.iterations[i].T_10.t - expected.t).norm(), 1e-4 * motion)
          << "level " << trace.level << " iteration " << i;
      EXPECT_LT((trace.iterations[i].T_10.R - expected.R).norm(), 1e-4) << "level " << trace.level << " iteration " << i;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Golden, LearnedCpu, testing::ValuesIn(test::kLearnedCases));

}  // namespace
}  // namespace iclk
