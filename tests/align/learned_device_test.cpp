// The learned model on the device against the executable specification.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include <iclk/align/device/stages.h>
#include <iclk/align/device/tiles.h>
#include <iclk/align/device/upload.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/engine/submission.h>

#include "device.h"
#include "learned_golden.h"
#include "read_back.h"

namespace iclk {
namespace {

using test::Golden;
using test::golden_model;

struct Case {
  const char* golden;
  int levels;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.golden; }
constexpr Case kCases[] = {{"learned_narrow_188x120", 4}, {"learned_paper_188x120", 4}, {"learned_five_levels_188x120", 5}};

AlignerOptions paper_options(int levels) {
  AlignerOptions options = Golden::paper_options();
  options.levels = levels;
  return options;
}

Plan plan_for(const Golden& golden) {
  Plan plan{golden.width(), golden.height()};
  plan.max_features = golden.features().size();
  plan.format = PixelFormat::rgba32f;
  return plan;
}

double largest(const std::vector<float>& values) {
  double most = 0;
  for (float v : values) most = std::max(most, std::abs(static_cast<double>(v)));
  return most;
}

using Way = std::tuple<Case, Solver>;

class LearnedDevice : public testing::TestWithParam<Way> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
  const Golden golden{std::get<0>(GetParam()).golden};
  const int levels = std::get<0>(GetParam()).levels;
  const Solver solver = std::get<1>(GetParam());
  const std::vector<float> rgb0 = golden.rgb("image0"), rgb1 = golden.rgb("image1");
};

TEST_P(LearnedDevice, EveryIteration) {
  const auto model = std::make_shared<const Model>(golden_model(golden));
  DeviceAligner aligner(test::device(), plan_for(golden), paper_options(levels), solver, model);
  aligner.set_reference(0, {golden.view(rgb0), golden.camera(), golden.features(), {}});
  const Alignment a = aligner.align(Pair{0, golden.view(rgb1), {}, {}});
  const double motion = golden.truth().t.norm();
  ASSERT_EQ(a.levels.size(), static_cast<size_t>(levels));
  for (const LevelTrace& trace : a.levels) {
    ASSERT_EQ(trace.iterations.size(), 10u);
    // Random weights make coarse maps that hardly differ, and a step is known no better than the residual it comes from. Where
    // products that are added are not rounded, that is 1.6e-3 of the motion; lavapipe has 1e-3.
    const auto& residual = golden.level(trace.level, "residual_start").data;
    const double rounding = 1e-6 * largest(golden.level(trace.level, "f0").data) / largest(residual);
    for (size_t i = 0; i < 10; ++i) {
      const SE3 expected =
          Golden::pose(&golden.level(trace.level, "R").data[9 * i], &golden.level(trace.level, "t").data[3 * i]);
      EXPECT_LT((trace.iterations[i].T_10.t - expected.t).norm(), (2e-3 + rounding) * motion)
          << "level " << trace.level << " iteration " << i;
      EXPECT_LT((trace.iterations[i].T_10.R - expected.R).norm(), 1e-4) << "level " << trace.level << " iteration " << i;
    }
  }
}

std::string case_name(const testing::TestParamInfo<Way>& info) {
  return std::get<0>(info.param).golden + std::string(std::get<1>(info.param) == Solver::device ? "_device" : "_host");
}
INSTANTIATE_TEST_SUITE_P(Golden, LearnedDevice,
                         testing::Combine(testing::ValuesIn(kCases), testing::Values(Solver::host, Solver::device)), case_name);

// The stages one by one, each level from the pose with which the specification starts it.
class LearnedStages : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};

TEST_P(LearnedStages, AgreeWithGolden) {
  const Golden golden(GetParam().golden);
  const int levels = GetParam().levels;
  const auto context = test::device();
  const auto model = std::make_shared<const Model>(golden_model(golden));
  const Plan plan = plan_for(golden);
  const AlignerOptions options = paper_options(levels);
  const Features features = golden.features();
  const Camera camera = golden.camera();

  const internal::Layout layout(plan, options, model.get());
  const internal::WorkgroupSizes sizes(context->info(), options);
  const internal::Kernels kernels(context, plan, options, Solver::host, layout, sizes);
  internal::AlignerBuffers ids(layout, plan, Solver::host, sizes, true, 1);
  internal::DeviceNetwork network(*context, model, layout, plan, 1, ids.plan);
  const internal::DeviceMatching matching(plan, options, layout, sizes, 1, ids.plan);
  const engine::Workspace memory(context, ids.plan);
  if (!memory[ids.pixels0].mapped) GTEST_SKIP() << "device memory is not mapped here";
  network.load(context, memory, sizes.iterate);
  const internal::RunBuffers run_ids(layout, plan, Solver::host, true, 1);
  const engine::Workspace run(context, run_ids.plan);
  engine::DescriptorArena arena(context, internal::Stages::arena_size(kernels, network, matching));
  const internal::Stages stages{layout, plan,    options, sizes,   kernels,  ids,
                                memory, run_ids, run,     network, matching, static_cast<uint32_t>(features.size())};

  std::memcpy(memory[ids.levels].mapped, layout.levels.data(), layout.levels.size() * sizeof(shaders::LevelInfo));
  const auto checks = check_features(features, camera);
  internal::TileLists tiles(plan, layout);
  const uint32_t tile_count =
      tiles.build(features, checks, memory[ids.tiles].as<shaders::MaskTile>(), memory[ids.entries].as<uint32_t>());
  *memory[ids.references].as<shaders::ReferenceInfo>() = {static_cast<float>(camera.fx),
                                                          static_cast<float>(camera.fy),
                                                          static_cast<float>(camera.cx),
                                                          static_cast<float>(camera.cy),
                                                          0.01f,
                                                          tile_count};
  for (int i = 0; i < features.size(); ++i) {
    const auto k = static_cast<size_t>(i);
    memory[ids.features].as<shaders::FeatureInfo>()[i] = {static_cast<float>(features.uv[k].x()),
                                                          static_cast<float>(features.uv[k].y()),
                                                          static_cast<float>(features.inverse_depth[k]), 0};
  }
  const auto rgb0 = golden.rgb("image0"), rgb1 = golden.rgb("image1");
  internal::convert_pixels(golden.view(rgb0), plan.format, layout.row_pixels(), memory[ids.pixels0].mapped);
  internal::convert_pixels(golden.view(rgb1), plan.format, layout.row_pixels(), memory[ids.pixels1].mapped);

  engine::Submission submission(context);
  SE3 start;
  for (int level = levels - 1; level >= 0; --level) {
    *run[run_ids.pairs].as<shaders::PairInfo>() = internal::pack_pair(start, nullptr, 0, 0, true, options);
    engine::Recorder recorder(submission, arena);
    if (level == levels - 1) {
      const internal::Stages::Run all{0, 1};
      stages.maps(recorder, std::span(&all, 1), 1);
      stages.prepare(recorder, all);
    }
    stages.weights(recorder, level, 1, ICLK_FLAG_GIVEN);
    stages.normal_equations(recorder, level, 1, 0, ICLK_FLAG_GIVEN);
    recorder.host_read({&memory[ids.parts]});
    submission.end();
    submission.submit_and_wait();

    const auto& info = layout.levels[static_cast<size_t>(level)];
    const auto f0 = test::read_back(memory[ids.maps0]), f1 = test::read_back(memory[ids.maps1]);
    const auto &g0 = golden.level(level, "f0").data, &g1 = golden.level(level, "f1").data;
    for (uint32_t v = 0; v < info.height; ++v)
      for (uint32_t u = 0; u < info.width; ++u) {
        ASSERT_NEAR(f0[info.map_offset + v * info.pitch + u], g0[v * info.width + u], 1e-4 * largest(g0)) << level;
        ASSERT_NEAR(f1[info.map_offset + v * info.pitch + u], g1[v * info.width + u], 1e-4 * largest(g1)) << level;
      }

    const auto a = test::read_back(memory[ids.template_a]), weights = test::read_back(memory[ids.weights]);
    const auto& weight = golden.level(level, "weight").data;
    int seen = 0;
    for (uint32_t k = 0; k < info.element_count; ++k) {
      const float* pixel = &a[4 * (info.element_offset + k)];
      if (pixel[2] == 0) continue;
      const float expected = weight[static_cast<size_t>(pixel[1]) * info.width + static_cast<size_t>(pixel[0])];
      // At the border a rounding decides whether a pixel is visible.
      const uint32_t lanes = sizes.iterate, block = k / (4 * lanes) * 4 * lanes;
      const float weight_k = weights[block + 4 * ((k - block) % lanes) + (k - block) / lanes];  // shaders/align/weights.glsl
      if ((weight_k == 0) != (expected == 0)) continue;
      ASSERT_NEAR(weight_k, expected, 1e-4) << "level " << level << " at " << pixel[0] << ", " << pixel[1];
      ++seen;
    }
    EXPECT_GE(seen, 50) << "level " << level;

    internal::NormalSums sums;
    for (uint32_t g = 0; g < internal::partial_groups(layout, sizes, level); ++g) {
      const auto part = internal::unpack_sums(memory[ids.parts].as<const float>() + g * ICLK_SUM_FLOATS);
      sums.H += part.H;
      sums.g += part.g;
      sums.visible += part.visible;
    }
    const auto &H = golden.level(level, "H_first").data, &g = golden.level(level, "g_first").data;
    for (int i = 0; i < 6; ++i) {
      const double d = std::sqrt(static_cast<double>(H[static_cast<size_t>(7 * i)]));
      // With random weights coarse maps hardly differ: their residual is the rounding of two numbers, g = sum sqrt(w) J
      // (sqrt(w) r).
      const double rounding = 4e-7 * largest(g0) * d * std::sqrt(sums.visible);
      EXPECT_NEAR(sums.g(i), g[static_cast<size_t>(i)], 1e-4 * largest(g) + rounding) << "level " << level;
      for (int j = 0; j < 6; ++j)
        EXPECT_NEAR(sums.H(i, j), H[static_cast<size_t>(6 * i + j)],
                    1e-4 * d * std::sqrt(static_cast<double>(H[static_cast<size_t>(7 * j)])))
            << "level " << level;
    }
    start = Golden::pose(&golden.level(level, "R").data[81], &golden.level(level, "t").data[27]);
  }
}
INSTANTIATE_TEST_SUITE_P(Golden, LearnedStages, testing::ValuesIn(kCases), [](const auto& info) { return info.param.golden; });

}  // namespace
}  // namespace iclk
