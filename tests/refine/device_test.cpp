// The shader against the CPU reference, on the validated device that all tests of the process share.
#include <cmath>
#include <limits>
#include <memory>

#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/refine/refiner.h>

#include "../support/synthetic.h"
#include "device.h"

namespace iclk {
namespace {

using internal::FeatureAlignmentTask;
using internal::make_feature_aligner;
using test::Picture;
using test::Scene;

Scene scene_of(int width, int height, double roll) {
  Scene scene;
  scene.camera = {0.6 * width, 0.6 * width, (width - 1) / 2.0, (height - 1) / 2.0, width, height};
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, roll;
  scene.T_10 = SE3::exp(xi);
  scene.gain = 1.3;
  scene.bias = -0.1;
  scene.noise = 0.005;
  return scene;
}

/// A CPU and a device aligner that hold the same images.
struct Both {
  Plan plan;
  AlignerOptions options;
  std::vector<Scene> scenes;  // one a pair; the first also makes the reference
  Features features;
  std::vector<Picture> targets;
  std::unique_ptr<CpuAligner> cpu;
  std::unique_ptr<DeviceAligner> device;

  Both(std::vector<Scene> s, int levels, Features f, PixelFormat format = PixelFormat::r32f)
      : scenes(std::move(s)), features(std::move(f)) {
    plan.width = scenes[0].camera.width;
    plan.height = scenes[0].camera.height;
    plan.max_references = 2;
    plan.max_pairs = static_cast<int>(scenes.size());
    plan.max_features = std::max(1, features.size());
    plan.format = format;
    options.levels = levels;
    cpu = std::make_unique<CpuAligner>(plan, options);
    device = std::make_unique<DeviceAligner>(test::device(), plan, options, Solver::device);
    const Picture I0 = test::render(scenes[0], 0, 1);
    Reference reference;
    reference.image = I0.view();
    reference.camera = scenes[0].camera;
    reference.features = features;
    for (Aligner* aligner : {static_cast<Aligner*>(cpu.get()), static_cast<Aligner*>(device.get())})
      aligner->set_reference(1, reference);
    for (const Scene& scene : scenes) targets.push_back(test::render(scene, 1, 1));
    align();
  }
  std::vector<Pair> pairs() const {
    std::vector<Pair> list(targets.size());
    for (size_t i = 0; i < list.size(); ++i) {
      list[i].reference = 1;
      list[i].target = targets[i].view();
    }
    return list;
  }
  void align() {
    cpu->align(pairs());
    device->align(pairs());
  }
  std::vector<FeatureAlignmentTask> tasks(double px) const {
    std::vector<FeatureAlignmentTask> list;
    for (size_t i = 0; i < scenes.size(); ++i) {
      Vector6d xi = Vector6d::Zero();
      xi[4] = px / scenes[i].camera.fx;
      list.push_back({1, static_cast<int>(i), scenes[i].T_10 * SE3::exp(xi)});
    }
    return list;
  }
};

void expect_alike(const std::vector<AlignedFeature>& cpu, const std::vector<AlignedFeature>& device) {
  ASSERT_EQ(cpu.size(), device.size());
  int other_status = 0;
  for (size_t i = 0; i < cpu.size(); ++i) {
    const AlignedFeature &a = cpu[i], &b = device[i];
    if (a.status != b.status) {  // a feature on the edge of a threshold
      ++other_status;
      continue;
    }
    if (a.status != FeatureStatus::aligned) continue;
    EXPECT_LT((a.uv1 - b.uv1).norm(), 2e-3) << i;
    EXPECT_LT((a.covariance - b.covariance).norm(), 0.01 * a.covariance.norm() + 1e-7) << i;
    EXPECT_NEAR(a.gain, b.gain, 1e-3) << i;
    EXPECT_NEAR(a.bias, b.bias, 1e-3) << i;
    EXPECT_NEAR(a.correlation, b.correlation, 1e-4) << i;
    EXPECT_LE(std::abs(a.iterations - b.iterations), 2) << i;
  }
  EXPECT_LE(other_status, 1 + static_cast<int>(cpu.size()) / 50);
}

Features with_bad_ones(Features f) {
  f.uv[0].x() = std::numeric_limits<double>::quiet_NaN();
  f.inverse_depth[1] = 0;
  f.uv[2] = {0, 0};
  f.uv[3] = {4.5, 4.5};
  return f;
}

TEST(RefineDevice, ShaderAgreesWithTheCpuReference) {
  ICLK_NEED_DEVICE();
  const std::vector<Scene> scenes{scene_of(376, 240, 0.03), scene_of(376, 240, 0.3), scene_of(376, 240, -0.1)};
  Both both(scenes, 4, with_bad_ones(test::random_features(scenes[0], 150, 4, 8)));
  for (double px : {0.0, 1.5, 6.0}) {
    SCOPED_TRACE(testing::Message() << px << " px");
    const auto tasks = both.tasks(px);
    const auto cpu = make_feature_aligner(*both.cpu)->align(tasks);
    const auto device = make_feature_aligner(*both.device)->align(tasks);
    ASSERT_EQ(cpu.size(), 3u);
    ASSERT_EQ(device.size(), 3u);
    for (size_t i = 0; i < 3; ++i) expect_alike(cpu[i].features, device[i].features);
    if (px == 0) {
      EXPECT_GT(count_aligned(device[0].features), 120);
    }
    std::vector<FeatureAlignmentTask> mixed = both.tasks(px);  // at half the size
    mixed[0].level = mixed[2].level = 1;
    const auto mixed_cpu = make_feature_aligner(*both.cpu)->align(mixed);
    const auto mixed_device = make_feature_aligner(*both.device)->align(mixed);
    for (size_t i = 0; i < 3; ++i) expect_alike(mixed_cpu[i].features, mixed_device[i].features);
    if (px < 2) {
      EXPECT_GT(count_aligned(mixed_device[0].features), 100);
    }
    EXPECT_EQ(mixed_device[1].features[9].uv1, device[1].features[9].uv1);
    EXPECT_NE(mixed_device[0].features[9].uv1, device[0].features[9].uv1);
  }
}

// The plan above has one channel, and level 0 is its pixels; colour has a map of its own for it.
TEST(RefineDevice, ColourPlansAgreeWithTheCpuReference) {
  ICLK_NEED_DEVICE();
  const std::vector<Scene> scenes{scene_of(376, 240, 0.03), scene_of(376, 240, 0.3)};
  Both both(scenes, 4, test::random_features(scenes[0], 100, 4, 8), PixelFormat::rgba32f);
  for (double px : {1.5, 6.0}) {  // level 0 alone; level 1 as well
    const auto tasks = both.tasks(px);
    const auto cpu = make_feature_aligner(*both.cpu)->align(tasks);
    const auto device = make_feature_aligner(*both.device)->align(tasks);
    for (size_t i = 0; i < scenes.size(); ++i) {
      expect_alike(cpu[i].features, device[i].features);
      if (px < 2) {
        EXPECT_GT(count_aligned(device[i].features), 60);
      }
    }
  }
}

TEST(RefineDevice, SmallImagesOddSizesAndOneLevel) {
  ICLK_NEED_DEVICE();
  for (const auto& [width, height, levels] : {std::tuple{203, 151, 1}, std::tuple{61, 47, 2}, std::tuple{16, 16, 2}}) {
    SCOPED_TRACE(testing::Message() << width << "x" << height);
    const Scene scene = scene_of(width, height, 0.01);
    Both both({scene}, levels, test::random_features(scene, 40, 4, 4));
    for (int level : {0, 1})
      for (double px : {0.0, 3.0}) {
        std::vector<FeatureAlignmentTask> tasks = both.tasks(px);
        tasks[0].level = level;
        const auto device = make_feature_aligner(*both.device)->align(tasks);
        expect_alike(make_feature_aligner(*both.cpu)->align(tasks)[0].features, device[0].features);
      }
  }
}

TEST(RefineDevice, TheSameInputGivesTheSameBits) {
  ICLK_NEED_DEVICE();
  const Scene scene = scene_of(376, 240, 0.03);
  Both both({scene}, 4, test::random_features(scene, 60, 4));
  const auto aligner = make_feature_aligner(*both.device);
  const auto a = aligner->align(both.tasks(2))[0].features, b = aligner->align(both.tasks(2))[0].features;
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].uv1, b[i].uv1);
    EXPECT_EQ(a[i].covariance, b[i].covariance);
    EXPECT_EQ(a[i].status, b[i].status);
  }
}

TEST(RefineDevice, MoreTasksThanTheBuffersHold) {
  ICLK_NEED_DEVICE();
  const Scene scene = scene_of(188, 120, 0.03);
  Both both({scene}, 3, test::random_features(scene, 30, 4));
  std::vector<FeatureAlignmentTask> tasks;
  for (int i = 0; i < 5; ++i) tasks.push_back(both.tasks(0.3 * i)[0]);  // room for one
  const auto aligner = make_feature_aligner(*both.device);
  const auto all = aligner->align(tasks);
  ASSERT_EQ(all.size(), 5u);
  for (size_t i = 0; i < tasks.size(); ++i) {
    const auto one = aligner->align(std::span(&tasks[i], 1))[0].features;
    for (size_t k = 0; k < one.size(); ++k) EXPECT_EQ(all[i].features[k].uv1, one[k].uv1);
  }
  EXPECT_TRUE(aligner->align({}).empty());
  for (const FeatureAlignmentTask& task : {FeatureAlignmentTask{-1, 0, {}}, FeatureAlignmentTask{2, 0, {}},
                                           FeatureAlignmentTask{1, 1, {}}, FeatureAlignmentTask{1, 0, {}, kLuma, false, 2}})
    EXPECT_THROW(aligner->align(std::span(&task, 1)), Error);
}

TEST(RefineDevice, NaNPixelsAndPosesAlignNothing) {
  ICLK_NEED_DEVICE();
  const Scene scene = scene_of(188, 120, 0.03);
  Both both({scene}, 3, test::random_features(scene, 30, 4));
  const auto expect_none = [&](const FeatureAlignmentTask& task) {
    const auto features = make_feature_aligner(*both.device)->align(std::span(&task, 1))[0].features;
    EXPECT_EQ(count_aligned(features), 0);
    for (const AlignedFeature& f : features)
      EXPECT_TRUE(f.uv1.allFinite() && f.covariance.allFinite() && std::isfinite(f.gain) && std::isfinite(f.correlation));
  };
  FeatureAlignmentTask task = both.tasks(0)[0];
  task.T_10.t.x() = std::numeric_limits<double>::quiet_NaN();
  expect_none(task);
  std::fill(both.targets[0].data.begin(), both.targets[0].data.end(), std::numeric_limits<float>::quiet_NaN());
  both.align();
  expect_none(both.tasks(0)[0]);
}

TEST(RefineDevice, RefinerFindsTheSamePoseOnEverySolver) {
  ICLK_NEED_DEVICE();
  const std::vector<Scene> scenes{scene_of(376, 240, 0.03), scene_of(376, 240, -0.02)};
  Both both(scenes, 4, test::random_features(scenes[0], 50, 4));
  DeviceAligner host(test::device(), both.plan, both.options, Solver::host);
  const Picture I0 = test::render(scenes[0], 0, 1);
  Reference reference;
  reference.image = I0.view();
  reference.camera = scenes[0].camera;
  reference.features = both.features;
  host.set_reference(1, reference);
  RefinerOptions options;
  options.structure = true;
  const auto cpu = Refiner(*both.cpu, options).align(both.pairs());
  for (DeviceAligner* aligner : {both.device.get(), &host}) {
    const auto device = Refiner(*aligner, options).align(both.pairs());
    for (size_t i = 0; i < cpu.size(); ++i) {
      ASSERT_TRUE(cpu[i].converged()) << cpu[i].reason;
      ASSERT_TRUE(device[i].converged()) << device[i].reason;
      const Vector6d d = (cpu[i].T_10.inverse() * device[i].T_10).log();
      EXPECT_LT(d.head<3>().norm(), 2e-3);  // of a scene 80 away
      EXPECT_LT(d.tail<3>().norm(), 2e-5);
    }
  }
}

}  // namespace
}  // namespace iclk
