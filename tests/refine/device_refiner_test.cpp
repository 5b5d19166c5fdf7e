// Refinement in a command buffer against Refiner on the same device, whose poses are Ceres's.
#include <cmath>
#include <cstring>

#include <gtest/gtest.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/error.h>
#include <iclk/engine/submission.h>
#include <iclk/refine/device_refiner.h>

#include "../support/synthetic.h"
#include "device.h"

namespace iclk {
namespace {

using test::Picture;
using test::Scene;

Scene scene_of(double roll, uint32_t seed = 1) {
  Scene scene;
  scene.camera = {240, 240, 187.5, 119.5, 376, 240};
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, roll;
  scene.T_10 = SE3::exp(xi);
  scene.gain = 1.3;
  scene.bias = -0.1;
  scene.noise = 0.005;
  scene.seed = seed;
  return scene;
}

/// Pictures in buffers of the application's.
struct Buffers {
  explicit Buffers(const std::vector<Picture>& pictures) {
    engine::MemoryPlan plan;
    std::vector<engine::BufferId> ids;
    for (const Picture& p : pictures)
      ids.push_back(
          plan.add("picture", p.data.size() * sizeof(float), engine::MemoryKind::upload, engine::BufferUse::transfer));
    memory = engine::Workspace(test::device(), plan);
    for (size_t i = 0; i < pictures.size(); ++i) {
      fill(memory[ids[i]], pictures[i]);
      images.push_back(DeviceBufferImage{memory[ids[i]].handle, memory[ids[i]].size, 0, 0});
      buffers.push_back(memory[ids[i]]);
    }
  }
  static void fill(const engine::Buffer& buffer, const Picture& picture) {
    std::memcpy(buffer.mapped, picture.data.data(), picture.data.size() * sizeof(float));
  }
  engine::Workspace memory;
  std::vector<DeviceImage> images;
  std::vector<engine::Buffer> buffers;
};

double motion(const Scene& scene, const Features& features, const SE3& a, const SE3& b) {
  double most = 0;
  for (const Eigen::Vector2d& uv : features.uv) {
    const Eigen::Vector3d X = scene.camera.ray(uv) * scene.depth(uv);
    most = std::max(most, (scene.camera.project(a * X) - scene.camera.project(b * X)).norm());
  }
  return most;
}

void expect_alike(const Scene& scene, const Features& features, const RefinedAlignment& recorded,
                  const RefinedAlignment& host) {
  EXPECT_EQ(recorded.status, host.status) << recorded.reason << "\n" << host.reason;
  EXPECT_EQ(recorded.refined, host.refined);
  EXPECT_LT(motion(scene, features, recorded.T_10, host.T_10), 5e-3);
  if (!host.refined) return;
  EXPECT_NEAR(recorded.inliers, host.inliers, 2);
  EXPECT_NEAR(recorded.aligned, host.aligned, 2);
  EXPECT_NEAR(recorded.visible, host.visible, 1);
  EXPECT_NEAR(recorded.sigma, host.sigma, 0.05 * host.sigma);
  EXPECT_LT((recorded.covariance - host.covariance).norm(), 0.1 * host.covariance.norm());
  EXPECT_NEAR(recorded.rounds, host.rounds, 1);
  ASSERT_EQ(recorded.features.size(), host.features.size());
  for (size_t i = 0; i < host.features.size(); ++i)
    if (recorded.features[i].status == FeatureStatus::aligned && host.features[i].status == FeatureStatus::aligned) {
      EXPECT_LT((recorded.features[i].uv1 - host.features[i].uv1).norm(), 0.02);
    }
}

TEST(DeviceRefiner, FindsWhatTheHostFinds) {
  ICLK_NEED_DEVICE();
  const Scene a = scene_of(0.03), b = scene_of(-0.1), elsewhere = scene_of(0.03, 9);
  Plan plan;
  plan.width = 376;
  plan.height = 240;
  plan.max_references = 2;
  plan.max_pairs = 3;
  plan.max_features = 120;
  plan.format = PixelFormat::r32f;
  Features features = test::random_features(a, 100, 4, 8);
  features.uv[0].x() = std::nan("");
  features.inverse_depth[1] = 0;
  const Picture reference = test::render(a, 0, 1);
  const std::vector<Picture> targets{test::render(a, 1, 1), test::render(b, 1, 1), test::render(elsewhere, 1, 1)};
  const std::vector<Scene> scenes{a, b, elsewhere};

  RefinerOptions options;
  options.feature_alignment.recolour = false;
  DeviceAligner host_aligner(test::device(), plan, {}, Solver::device);
  Refiner host(host_aligner, options);
  host_aligner.set_reference(1, {reference.view(), a.camera, features, {}});
  std::vector<Pair> pairs;
  for (const Picture& target : targets) pairs.push_back({1, target.view(), {}, {}});
  const auto expected = host.align(pairs);
  ASSERT_TRUE(expected[0].converged() && expected[1].converged() && !expected[2].converged());
  Features finite = features;
  finite.uv.erase(finite.uv.begin(), finite.uv.begin() + 2);
  EXPECT_LT(motion(a, finite, expected[0].T_10, a.T_10), 0.1);

  DeviceAligner aligner(test::device(), plan, {}, Solver::device);
  DeviceRefiner refiner(aligner, options);
  const Buffers images({reference, targets[0], targets[1], targets[2]});
  const auto recording = refiner.make_recording(3);
  const DeviceReference given{1, images.images[0], a.camera, features};
  const std::vector<DevicePair> device_pairs{
      {1, images.images[1], {}, {}}, {1, images.images[2], {}, {}}, {1, images.images[3], {}, {}}};
  engine::Submission submission(test::device());
  refiner.record(*recording, submission.begin(), {&given, 1}, device_pairs);
  submission.end();
  for (int execution = 0; execution < 2; ++execution) {
    submission.submit_and_wait();
    const auto results = recording->read();
    ASSERT_EQ(results.size(), 3u);
    for (size_t i = 0; i < 3; ++i) {
      SCOPED_TRACE(testing::Message() << "pair " << i << ", execution " << execution);
      expect_alike(scenes[i], finite, results[i], expected[i]);
    }
  }
  // The same commands see new pixels: the first target has become the second.
  Buffers::fill(images.buffers[1], targets[1]);
  submission.submit_and_wait();
  expect_alike(b, finite, recording->read()[0], expected[1]);
}

TEST(DeviceRefiner, RefusesWhatItCannotDo) {
  ICLK_NEED_DEVICE();
  Plan plan;
  plan.width = 64;
  plan.height = 48;
  plan.format = PixelFormat::r32f;
  plan.max_features = ICLK_REFINE_FEATURES + 1;
  AlignerOptions small;
  small.levels = 2;
  {
    DeviceAligner aligner(test::device(), plan, small, Solver::device);
    EXPECT_THROW(DeviceRefiner{aligner}, Error);
  }
  plan.max_features = 10;
  DeviceAligner aligner(test::device(), plan, small, Solver::device);
  RefinerOptions options;
  options.structure = true;
  EXPECT_THROW(DeviceRefiner(aligner, options), Error);
  DeviceRefiner refiner(aligner);
  EXPECT_THROW(refiner.make_recording(0), Error);
  EXPECT_THROW(refiner.make_recording(plan.max_pairs + 1), Error);
}

}  // namespace
}  // namespace iclk
