// Refinement behind a learned model: feature alignment is photometric, so it is that of the classical mode bit by bit.
#include <cstring>

#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device/parts.h>
#include <iclk/align/device_aligner.h>
#include <iclk/align/device_recording.h>
#include <iclk/engine/submission.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/refine/refiner.h>

#include "../align/learned_golden.h"
#include "../support/synthetic.h"
#include "device.h"

namespace iclk {
namespace {

using internal::FeatureAligner;
using internal::FeatureAlignmentTask;
using test::Scene;

constexpr int kLevels = 4;

std::shared_ptr<const Model> golden_model() {
  static const auto model = std::make_shared<const Model>(test::golden_model(test::Golden("learned_narrow_188x120")));
  return model;
}

AlignerOptions options_of(const Model& model) {
  AlignerOptions options = model.options();
  options.iterations = 2;  // the pose of the alignment is not what is tested
  return options;
}

Scene scene_of(uint32_t seed) {
  Scene scene;
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, 0.02 * seed;
  scene.T_10 = SE3::exp(xi);
  scene.seed = seed;
  scene.gain = 1.2;
  scene.bias = -0.05;
  return scene;
}

/// Pixels of colour: luma is none of the channels.
struct ColourImage {
  int width, height;
  std::vector<float> data;
  ColourImage(const Scene& scene, int which) : width(scene.camera.width), height(scene.camera.height) {
    for (const float I : test::render(scene, which, scene.seed).data) data.insert(data.end(), {I, 0.9f * I, 1 - I, 1.0f});
  }
  ImageView view() const { return {data.data(), width, height, 0, PixelFormat::rgba32f}; }
};

std::unique_ptr<Aligner> make(Solver solver, const Plan& plan, const AlignerOptions& options,
                              const std::shared_ptr<const Model>& model) {
  if (solver == Solver::cpu) return make_cpu_aligner(plan, options, model);
  return make_device_aligner(test::device(), plan, options, solver, model);
}

void expect_same(const std::vector<AlignedFeature>& a, const std::vector<AlignedFeature>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].status, b[i].status) << i;
    EXPECT_EQ(a[i].uv1, b[i].uv1) << i;
    EXPECT_EQ(a[i].covariance, b[i].covariance) << i;
    EXPECT_EQ(a[i].gain, b[i].gain) << i;
    EXPECT_EQ(a[i].bias, b[i].bias) << i;
    EXPECT_EQ(a[i].correlation, b[i].correlation) << i;
    EXPECT_EQ(a[i].iterations, b[i].iterations) << i;
  }
}

/// An aligner with the model and one without hold the same images; so do their feature aligners.
struct Both {
  Plan plan;
  std::unique_ptr<Aligner> aligners[2];
  std::unique_ptr<FeatureAligner> features[2];

  Both(Solver solver, PixelFormat format, int levels = kLevels, bool dense = false) {
    plan = {188, 120};
    plan.max_references = 3;
    plan.max_pairs = 2;
    plan.max_features = 40;
    plan.dense = dense;
    plan.format = format;
    AlignerOptions options = options_of(*golden_model());
    options.levels = levels;
    for (const bool learned : {false, true}) {
      aligners[learned] = make(solver, plan, options, learned ? golden_model() : nullptr);
      features[learned] = internal::make_feature_aligner(*aligners[learned]);
    }
  }
  void set_reference(int slot, const Scene& scene) {
    const ColourImage image(scene, 0);
    test::Picture q{plan.width, plan.height, {}};
    for (int v = 0; plan.dense && v < q.height; ++v)
      for (int u = 0; u < q.width; ++u)
        q.data.push_back(static_cast<float>(1 / scene.depth({static_cast<double>(u), static_cast<double>(v)})));
    for (const auto& aligner : aligners)
      aligner->set_reference(slot, {image.view(), scene.camera, test::random_features(scene, 40, scene.seed, 12),
                                    plan.dense ? q.view() : ImageView{}});
  }
  void align(const std::vector<std::pair<int, Scene>>& pairs) {
    std::vector<ColourImage> images;
    std::vector<Pair> list;
    for (const auto& [slot, scene] : pairs) images.emplace_back(scene, 1);
    for (size_t i = 0; i < pairs.size(); ++i) list.push_back({pairs[i].first, images[i].view(), {}, {}});
    for (const auto& aligner : aligners) (void)aligner->align(list);
  }
  /// `seen`: the target of a pair shows the scene of its reference.
  void expect_same_features(const std::vector<FeatureAlignmentTask>& tasks, bool seen = true) {
    const auto classical = features[0]->align(tasks), learned = features[1]->align(tasks);
    ASSERT_EQ(learned.size(), tasks.size());
    for (size_t i = 0; i < tasks.size(); ++i) {
      SCOPED_TRACE(testing::Message() << "task " << i);
      expect_same(learned[i].features, classical[i].features);
      EXPECT_EQ(count_aligned(learned[i].features) > 25, seen) << summary(learned[i].features);
    }
  }
};

/// Three pixels beside the truth: some features need level 1.
SE3 guess(const Scene& scene) {
  Vector6d xi = Vector6d::Zero();
  xi[4] = 3 / scene.camera.fx;
  return scene.T_10 * SE3::exp(xi);
}

class LearnedRefinement : public testing::TestWithParam<Solver> {
 protected:
  void SetUp() override {
    if (GetParam() != Solver::cpu) ICLK_NEED_DEVICE();
  }
};

// Grey maps are kept: a keyframe's until it is set anew, a target's until the next batch.
TEST_P(LearnedRefinement, KeyframesAndTargetsThatChangeAreSeen) {
  const Scene a = scene_of(1), b = scene_of(2), c = scene_of(3);
  Scene nearer = a;
  nearer.T_10.t *= 0.5;
  Both both(GetParam(), PixelFormat::rgba8);
  both.set_reference(0, a);
  both.set_reference(1, b);
  both.align({{0, a}, {1, b}});
  both.expect_same_features({{0, 0, guess(a)}});  // pair 1 and slot 1 are not asked for yet
  both.expect_same_features({{0, 0, a.T_10}, {1, 1, guess(b)}, {1, 1, b.T_10}});
  both.expect_same_features({{1, 0, b.T_10}, {0, 1, a.T_10}}, false);
  both.align({{0, nearer}});  // another target of the same keyframe
  both.expect_same_features({{0, 0, guess(nearer)}});
  both.set_reference(0, c);
  both.set_reference(2, a);
  both.align({{0, c}, {2, a}});
  both.expect_same_features({{0, 0, guess(c)}, {2, 1, guess(a)}});
  both.align({{1, b}, {0, c}});
  both.expect_same_features({{1, 0, guess(b)}, {0, 1, guess(c)}});
}

std::string solver_name(const testing::TestParamInfo<Solver>& info) {
  return info.param == Solver::cpu ? "cpu" : info.param == Solver::host ? "host" : "device";
}
INSTANTIATE_TEST_SUITE_P(Solvers, LearnedRefinement, testing::Values(Solver::cpu, Solver::host, Solver::device), solver_name);

TEST(LearnedRefinementDevice, EveryFormatGivesTheFeaturesOfTheClassicalMode) {
  ICLK_NEED_DEVICE();
  const Scene a = scene_of(1), b = scene_of(2);
  for (const PixelFormat format : {PixelFormat::r8, PixelFormat::rgba8, PixelFormat::r32f, PixelFormat::rgba32f}) {
    SCOPED_TRACE(testing::Message() << "format " << static_cast<int>(format));
    Both both(Solver::device, format);
    both.set_reference(0, a);
    both.set_reference(2, b);
    both.align({{2, b}, {0, a}});
    both.expect_same_features({{0, 1, guess(a)}, {2, 0, guess(b)}});
  }
}

TEST(LearnedRefinementDevice, OneLevelAndDenseMode) {
  ICLK_NEED_DEVICE();
  const Scene scene = scene_of(1);
  for (const auto& [format, levels, dense] : {std::tuple{PixelFormat::r8, 1, false}, {PixelFormat::rgba8, kLevels, true}}) {
    Both both(Solver::device, format, levels, dense);
    both.set_reference(1, scene);
    both.align({{1, scene}});
    both.expect_same_features({{1, 0, scene.T_10}});
  }
}

// The images of a recording change whenever the application executes it.
TEST(LearnedRefinementDevice, ImagesOfARecordingAreThoseOfItsLastExecution) {
  ICLK_NEED_DEVICE();
  const Scene a = scene_of(1), b = scene_of(2);
  const ColourImage images[] = {ColourImage(a, 0), ColourImage(a, 1), ColourImage(b, 0), ColourImage(b, 1)};
  const size_t bytes = images[0].data.size() * sizeof(float);
  Both both(Solver::device, PixelFormat::rgba32f);
  engine::MemoryPlan plan;
  const auto id0 = plan.add("reference", bytes, engine::MemoryKind::upload, engine::BufferUse::transfer);
  const auto id1 = plan.add("target", bytes, engine::MemoryKind::upload, engine::BufferUse::transfer);
  const engine::Workspace memory(test::device(), plan);
  const auto image = [&](engine::BufferId id) { return DeviceBufferImage{memory[id].handle, memory[id].size, 0, 0}; };
  const DeviceReference reference{1, image(id0), a.camera, test::random_features(a, 40, 1, 12)};
  const DevicePair pair{1, image(id1), {}, {}};

  engine::Submission submissions[] = {engine::Submission(test::device()), engine::Submission(test::device())};
  std::unique_ptr<DeviceAligner::Recording> recordings[2];
  for (const int i : {0, 1}) {
    auto& aligner = dynamic_cast<DeviceAligner&>(*both.aligners[i]);
    recordings[i] = aligner.make_recording();
    aligner.record(*recordings[i], submissions[i].begin(), {&reference, 1}, {&pair, 1});
    submissions[i].end();
  }
  for (const size_t first : {0u, 2u, 0u}) {  // a's images, b's, a's
    std::memcpy(memory[id0].mapped, images[first].data.data(), bytes);
    std::memcpy(memory[id1].mapped, images[first + 1].data.data(), bytes);
    for (engine::Submission& submission : submissions) submission.submit_and_wait();
    both.expect_same_features({{1, 0, (first ? b : a).T_10}});
  }
}

TEST(LearnedRefinementDevice, GreyMapsAreMadeOnceAndOnlyWhereTheAlignersDoNotServe) {
  ICLK_NEED_DEVICE();
  const Scene scene = scene_of(1);
  Both both(Solver::device, PixelFormat::rgba8);
  for (const int slot : {0, 1, 2}) both.set_reference(slot, scene);
  engine::Submission submission(test::device());
  for (const bool learned : {false, true}) {
    const auto grey = internal::DeviceParts::make_grey_maps(dynamic_cast<DeviceAligner&>(*both.aligners[learned]));
    engine::ArenaSize size;
    grey->add_to(size);
    engine::DescriptorArena arena(test::device(), size);
    const auto dispatches = [&](const std::vector<int>& slots, const std::vector<internal::GreyTarget>& pairs,
                                bool execute = true) {
      engine::Recorder recorder(submission, arena);
      grey->record(recorder, slots, pairs);
      recorder.finish();
      submission.end();
      if (!execute) return recorder.dispatches();
      submission.submit_and_wait();
      grey->executed();
      return recorder.dispatches();
    };
    const uint32_t one = learned;
    both.align({{0, scene}, {1, scene}});
    EXPECT_EQ(dispatches({0, 1, 0}, {{0}, {1}}, false), 2 * one);
    EXPECT_EQ(dispatches({0, 1, 0}, {{0}, {1}}), 2 * one);
    EXPECT_EQ(dispatches({1, 0}, {{1}, {0}}), 0u);
    EXPECT_EQ(dispatches({2, 0}, {{0}}), one);
    both.align({{0, scene}});
    EXPECT_EQ(dispatches({0, 1, 2}, {{0}}), one);
    const GreyWeights red = {1, 0, 0};
    both.align({{0, scene}, {1, scene}});
    EXPECT_EQ(dispatches({0, 1}, {{0, red}, {1, red}}), 1u);
    EXPECT_EQ(dispatches({0, 1}, {{0, red}, {1, red}}), 0u);
    EXPECT_EQ(dispatches({0, 1}, {{0, red}, {1}}), 1u);
    EXPECT_EQ(dispatches({0, 1}, {{0}, {1}}), one);
    EXPECT_EQ(dispatches({0, 1}, {{0, {0, 1, 0}}, {1, red}}), 2u);
  }
  for (const bool learned : {false, true}) {
    engine::ArenaSize size;
    internal::DeviceParts::make_grey_maps(dynamic_cast<DeviceAligner&>(*both.aligners[learned]), false)->add_to(size);
    EXPECT_EQ(size.sets > 0, learned);
  }
}

TEST(LearnedRefinementDevice, TheRefinerGivesThePoseOfTheCpuReference) {
  ICLK_NEED_DEVICE();
  const Scene scene = scene_of(1), other = scene_of(3);
  const ColourImage image0(scene, 0), image1(scene, 1), unrelated(other, 1);
  const Features features = test::random_features(scene, 40, 1, 12);
  const auto error = [&](const SE3& T_10) {  // px, mean
    double sum = 0;
    for (const Eigen::Vector2d& uv : features.uv)
      sum += (scene.camera.project(T_10 * (scene.camera.ray(uv) * scene.depth(uv))) - scene.truth(uv)).norm();
    return sum / features.size();
  };
  Plan plan{188, 120};
  plan.max_pairs = 2;
  plan.format = PixelFormat::rgba32f;
  RefinerOptions options;
  options.structure = true;
  std::vector<RefinedAlignment> cpu;
  for (const Solver solver : {Solver::cpu, Solver::host, Solver::device}) {
    const auto aligner = make(solver, plan, golden_model()->options(), golden_model());
    aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
    Refiner refiner(*aligner, options);
    const std::vector<Pair> pairs{{0, image1.view(), guess(scene), {}}, {0, unrelated.view(), guess(scene), {}}};
    const auto results = refiner.align(pairs);
    // The maps of random weights, without gain and bias, leave a fifth of a pixel; grey patches do not.
    ASSERT_TRUE(results[0].converged()) << results[0].reason;
    EXPECT_GT(error(results[0].iclk.T_10), 0.1);
    EXPECT_LT(error(results[0].T_10), 0.01);
    EXPECT_FALSE(results[1].converged()) << results[1].reason;
    if (solver == Solver::cpu) {
      cpu = results;
      continue;
    }
    const Vector6d d = (cpu[0].T_10.inverse() * results[0].T_10).log();
    EXPECT_LT(d.head<3>().norm(), 2e-3);  // of a scene 80 away
    EXPECT_LT(d.tail<3>().norm(), 2e-5);
    EXPECT_EQ(cpu[0].aligned, results[0].aligned);
  }
}

}  // namespace
}  // namespace iclk
