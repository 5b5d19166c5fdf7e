// The Vulkan solvers against the executable specification and against the CPU reference.
#include <gtest/gtest.h>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device/parts.h>
#include <iclk/align/device/stages.h>
#include <iclk/align/device_aligner.h>
#include <iclk/align/solver/jacobian.h>
#include <iclk/align/solver/mask.h>

#include "golden.h"
#include "read_back.h"

namespace iclk {
namespace {

using test::Golden;

struct Case {
  const char* golden;
  Solver solver;
};

std::string text(const Case& c) { return std::string(c.golden) + (c.solver == Solver::device ? "_device" : "_host"); }
void PrintTo(const Case& c, std::ostream* out) { *out << text(c); }

class ParityDevice : public testing::TestWithParam<Case> {
 protected:
  ParityDevice() : golden(GetParam().golden), camera(golden.camera()), features(golden.features()) {
    rgb0 = golden.rgb("image0");
    rgb1 = golden.rgb("image1");
  }
  Plan plan() const {
    Plan p{golden.width(), golden.height()};
    p.max_features = features.size();
    p.format = PixelFormat::rgba32f;
    return p;
  }

  Golden golden;
  Camera camera;
  Features features;
  std::vector<float> rgb0, rgb1;
};

TEST_P(ParityDevice, EveryIteration) {
  ICLK_NEED_DEVICE();
  DeviceAligner aligner(test::device(), plan(), Golden::paper_options(), GetParam().solver);
  aligner.set_reference(0, {golden.view(rgb0), camera, features, {}});
  const Alignment a = aligner.align(Pair{0, golden.view(rgb1), {}, {}});
  const double motion = golden.truth().t.norm();
  ASSERT_EQ(a.levels.size(), 4u);
  for (const LevelTrace& trace : a.levels) {
    ASSERT_EQ(trace.iterations.size(), 10u);
    for (size_t i = 0; i < 10; ++i) {
      const SE3 expected =
          Golden::pose(&golden.level(trace.level, "R").data[9 * i], &golden.level(trace.level, "t").data[3 * i]);
      EXPECT_LT((trace.iterations[i].T_10.t - expected.t).norm(), 1e-3 * motion)
          << "level " << trace.level << " iteration " << i;
      EXPECT_LT((trace.iterations[i].T_10.R - expected.R).norm(), 1e-4) << "level " << trace.level << " iteration " << i;
    }
  }
  EXPECT_LT((a.T_10.t - golden.result().t).norm(), 1e-4 * motion);
  EXPECT_LT((a.T_10.R - golden.result().R).norm(), 1e-5);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
}

INSTANTIATE_TEST_SUITE_P(Golden, ParityDevice,
                         testing::Values(Case{"classical_188x120", Solver::device}, Case{"classical_188x120", Solver::host},
                                         Case{"classical_odd_203x151", Solver::device},
                                         Case{"classical_odd_203x151", Solver::host}),
                         [](const auto& info) { return text(info.param); });

// Runs the device's stages one by one and reads their buffers.
class DeviceStages : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};

TEST_P(DeviceStages, AgreeWithGolden) {
  const Golden golden(GetParam());
  const auto context = test::device();
  const auto rgb0 = golden.rgb("image0"), rgb1 = golden.rgb("image1");
  const Features features = golden.features();
  const Camera camera = golden.camera();
  Plan plan{golden.width(), golden.height()};
  plan.max_features = features.size();
  plan.format = PixelFormat::rgba32f;
  const AlignerOptions options = Golden::paper_options();

  DeviceAligner aligner(context, plan, options, Solver::device);
  aligner.set_reference(0, {golden.view(rgb0), camera, features, {}});
  (void)aligner.align(Pair{0, golden.view(rgb1), {}, {}});
  const auto maps = internal::DeviceParts::maps(aligner);
  const auto maps0 = test::read_back(*maps.maps0), maps1 = test::read_back(*maps.maps1);
  const internal::Layout layout(plan, options);
  for (int level = 0; level < 4; ++level) {
    const auto& info = layout.levels[static_cast<size_t>(level)];
    const auto &f0 = golden.level(level, "f0").data, &f1 = golden.level(level, "f1").data;
    for (uint32_t v = 0; v < info.height; ++v)
      for (uint32_t u = 0; u < info.width; ++u) {
        ASSERT_NEAR(maps0[info.map_offset + v * info.pitch + u], f0[v * info.width + u], 1e-5) << level << " " << u << " " << v;
        ASSERT_NEAR(maps1[info.map_offset + v * info.pitch + u], f1[v * info.width + u], 1e-5) << level << " " << u << " " << v;
      }
  }

  const auto a = test::read_back(internal::DeviceParts::template_pixels(aligner)),
             b = test::read_back(internal::DeviceParts::template_gradients(aligner));
  const auto checks = check_features(features, camera);
  for (int level = 0; level < 4; ++level) {
    const auto& info = layout.levels[static_cast<size_t>(level)];
    const auto& expected = golden.level(level, "inverse_depth_mask").data;
    std::vector<float> dense(expected.size(), 0.0f);
    for (uint32_t k = 0; k < info.element_count; ++k) {
      const float* p = &a[4 * (info.element_offset + k)];
      if (p[2] == 0) continue;
      float& q = dense[static_cast<size_t>(p[1]) * info.width + static_cast<size_t>(p[0])];
      ASSERT_EQ(q, 0.0f) << "pixel in two patches";
      q = p[2];
    }
    for (size_t i = 0; i < dense.size(); ++i) ASSERT_NEAR(dense[i], expected[i], 1e-5 * expected[i]) << "level " << level;
    // The template's gradients against the CPU reference, whose H and g are the golden ones.
    Map f0(static_cast<int>(info.width), static_cast<int>(info.height));
    f0.data = golden.level(level, "f0").data;
    const auto mask = internal::sparse_mask(features, checks, camera, level);
    const auto reference = internal::sparse_template(f0, features, mask, level);
    for (uint32_t k = 0; k < info.element_count; ++k) {
      ASSERT_NEAR(b[4 * (info.element_offset + k)], reference[k].gu, 1e-5);
      ASSERT_NEAR(b[4 * (info.element_offset + k) + 1], reference[k].gv, 1e-5);
      ASSERT_NEAR(a[4 * (info.element_offset + k) + 3], reference[k].f0, 1e-5);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Golden, DeviceStages, testing::Values("classical_188x120", "classical_odd_203x151"));

}  // namespace
}  // namespace iclk
