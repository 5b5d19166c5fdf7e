// Aligners with a model: batches, keyframes, recordings, levels, dense mode, devices without subgroups.
#include <iclk/align/device_recording.h>
#include <iclk/align/network/tiling.h>
#include <iclk/engine/error.h>
#include <iclk/engine/submission.h>

#include "plain_network.h"
#include "solvers.h"

namespace iclk::test {
namespace {

AlignerOptions options_of(const Model& model) {
  AlignerOptions options = model.options();
  options.step_tolerance = 0;
  options.iterations = 4;
  return options;
}

struct Scenes {
  explicit Scenes(int n) {
    for (int i = 0; i < n; ++i) {
      Relief scene;
      scene.seed = static_cast<uint32_t>(i + 1);
      scene.T_10.t = {0.02 + 0.01 * i, -0.01, 0.02};
      scenes.push_back(scene);
      features.push_back(random_features(scene, 20 + 5 * i, scene.seed));
      image0.push_back(render(scene, 0));
      image1.push_back(render(scene, 1));
    }
  }
  Reference reference(size_t i) const { return {image0[i].view(), scenes[i].camera, features[i], {}}; }
  std::vector<Relief> scenes;
  std::vector<Features> features;
  std::vector<Frame> image0, image1;
};

// Every pose of every iteration: weights of all levels are in them.
bool same_trace(const Alignment& a, const Alignment& b) {
  if (a.levels.size() != b.levels.size()) return false;
  for (size_t l = 0; l < a.levels.size(); ++l) {
    if (a.levels[l].iterations.size() != b.levels[l].iterations.size()) return false;
    for (size_t i = 0; i < a.levels[l].iterations.size(); ++i)
      if (a.levels[l].iterations[i].T_10.R != b.levels[l].iterations[i].T_10.R ||
          a.levels[l].iterations[i].T_10.t != b.levels[l].iterations[i].T_10.t)
        return false;
  }
  return true;
}

double pose_difference(const Alignment& a, const Alignment& b) {
  return (a.T_10.R - b.T_10.R).norm() + (a.T_10.t - b.T_10.t).norm();
}

class LearnedAligner : public testing::TestWithParam<Solver> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
  std::unique_ptr<DeviceAligner> aligner(int pairs, const std::shared_ptr<const Model>& model) const {
    Plan plan = plan_for({1, 1, 0, 0, 160, 120});
    plan.max_references = plan.max_pairs = pairs;
    return make_device_aligner(device(), plan, options_of(*model), GetParam(), model);
  }
};

TEST_P(LearnedAligner, ABatchIsTheSinglesBitByBit) {
  const std::shared_ptr<const Model> model = odd_model();
  const Scenes s(3);
  const auto batch = aligner(3, model);
  std::vector<Pair> pairs;
  for (size_t i = 0; i < 3; ++i) {
    const int slot = static_cast<int>((i + 1) % 3);
    batch->set_reference(slot, s.reference(i));
    pairs.push_back({slot, s.image1[i].view(), {}, {}});
  }
  const auto together = batch->align(pairs);
  const auto one = aligner(1, model);
  for (size_t i = 0; i < 3; ++i) {
    one->set_reference(0, s.reference(i));
    const Alignment alone = one->align(Pair{0, s.image1[i].view(), {}, {}});
    EXPECT_TRUE(same_bits(alone, together[i])) << i;
    EXPECT_TRUE(same_trace(alone, together[i])) << i;
    // A keyframe keeps its maps: another target in between changes nothing.
    (void)one->align(Pair{0, s.image1[(i + 1) % 3].view(), {}, {}});
    EXPECT_TRUE(same_trace(one->align(Pair{0, s.image1[i].view(), {}, {}}), alone)) << i;
  }
}

TEST_P(LearnedAligner, FewerLevelsAreTheFinestOfADeeperModel) {
  const auto model = odd_model();
  const Scenes s(1);
  auto finest = std::make_shared<Model>(*model);
  finest->encoder.resize(2);
  Plan plan = plan_for(s.scenes[0].camera);
  const AlignerOptions options = options_of(*finest);
  const auto a = make_device_aligner(device(), plan, options, GetParam(), model);
  const auto b = make_device_aligner(device(), plan, options, GetParam(), finest);
  for (const auto& which : {a.get(), b.get()}) which->set_reference(0, s.reference(0));
  const Pair pair{0, s.image1[0].view(), {}, {}};
  EXPECT_TRUE(same_trace(a->align(pair), b->align(pair)));
}

TEST_P(LearnedAligner, WeightsCountAndTheirAbsenceIsUnit) {
  const auto model = odd_model();
  auto bare = std::make_shared<Model>(*model), even = std::make_shared<Model>(*model);
  bare->m_estimator.clear();
  for (ConvLayer& layer : even->m_estimator) layer.weight.assign(layer.weight.size(), 0.0f);  // the same weight everywhere
  const Scenes s(1);
  std::vector<Alignment> results;
  for (const auto& m : {model, even, bare}) {
    const auto one = aligner(1, m);
    one->set_reference(0, s.reference(0));
    results.push_back(one->align(Pair{0, s.image1[0].view(), {}, {}}));
  }
  EXPECT_LT(pose_difference(results[1], results[2]), 2e-5);
  EXPECT_GT(pose_difference(results[0], results[2]), 1e-4);
  const double bias = even->m_estimator.back().bias[0], weight = 1 / (1 + std::exp(-(bias > 0 ? bias : std::expm1(bias))));
  EXPECT_LT((results[1].H - weight * results[2].H).norm(), 1e-3 * results[1].H.norm());
}

TEST_P(LearnedAligner, DenseModeGivesTheWeightsOfThePatches) {
  auto model = odd_model();
  model->encoder.resize(1);
  const Scenes s(1);
  Camera camera = s.scenes[0].camera;
  // Patches that do not overlap, and a depth image that is nothing else; one hangs over no block's border, others do.
  Features features;
  Frame q{camera.width, camera.height, std::vector<float>(static_cast<size_t>(camera.width * camera.height), 0.0f)};
  for (int y = 10; y < 110; y += 19)
    for (int x = 10; x < 150; x += 17) {
      features.uv.emplace_back(x + 0.25, y + 0.5);
      features.inverse_depth.push_back(1 / s.scenes[0].depth(features.uv.back()));
      for (int v = y - 3; v < y + 5; ++v)
        for (int u = x - 3; u < x + 5; ++u) q.at(u, v) = static_cast<float>(features.inverse_depth.back());
    }
  Plan sparse = plan_for(camera, features.size()), dense = sparse;
  dense.dense = true;
  const AlignerOptions options = options_of(*model);
  const auto a = make_device_aligner(device(), sparse, options, GetParam(), model),
             b = make_device_aligner(device(), dense, options, GetParam(), model);
  a->set_reference(0, {s.image0[0].view(), camera, features, {}});
  b->set_reference(0, {s.image0[0].view(), camera, {}, q.view()});
  const Pair pair{0, s.image1[0].view(), {}, {}};
  const Alignment patches = a->align(pair), pixels = b->align(pair);
  EXPECT_LT(pose_difference(patches, pixels), 1e-4);
  EXPECT_NEAR(patches.cost, pixels.cost, 1e-4 * patches.cost);
  EXPECT_GT(patches.cost, 0);
}

TEST_P(LearnedAligner, ADeviceWithoutSubgroupsGivesTheSame) {
  const std::shared_ptr<const Model> model = odd_model();
  const auto context = device_without_subgroups();
  ASSERT_EQ(context->info().subgroup_operations, 0u);
  const Scenes s(1);
  const auto plain = make_device_aligner(context, plan_for(s.scenes[0].camera), options_of(*model), GetParam(), model);
  const auto usual = make_device_aligner(device(), plan_for(s.scenes[0].camera), options_of(*model), GetParam(), model);
  const Pair pair{0, s.image1[0].view(), {}, {}};
  plain->set_reference(0, s.reference(0));
  usual->set_reference(0, s.reference(0));
  EXPECT_LT(pose_difference(plain->align(pair), usual->align(pair)), 1e-5);
}

INSTANTIATE_TEST_SUITE_P(Solvers, LearnedAligner, testing::Values(Solver::host, Solver::device),
                         [](const auto& info) { return info.param == Solver::device ? "device" : "host"; });

TEST(LearnedRecording, IsTheAlignment) {
  ICLK_NEED_DEVICE();
  const std::shared_ptr<const Model> model = odd_model();
  const Scenes s(1);
  const Plan plan = plan_for(s.scenes[0].camera);
  const auto context = device();
  DeviceAligner aligner(context, plan, options_of(*model), Solver::device, model);
  aligner.set_reference(0, s.reference(0));
  const Alignment expected = aligner.align(Pair{0, s.image1[0].view(), {}, {}});

  engine::MemoryPlan images;
  const auto bytes = s.image0[0].data.size() * 4;
  const auto id0 = images.add("reference", bytes, engine::MemoryKind::upload, engine::BufferUse::transfer);
  const auto id1 = images.add("target", bytes, engine::MemoryKind::upload, engine::BufferUse::transfer);
  const engine::Workspace memory(context, images);
  std::copy(s.image0[0].data.begin(), s.image0[0].data.end(), memory[id0].as<float>());
  std::copy(s.image1[0].data.begin(), s.image1[0].data.end(), memory[id1].as<float>());
  DeviceAligner fresh(context, plan, options_of(*model), Solver::device, model);
  const auto recording = fresh.make_recording();
  engine::Submission submission(context);
  const DeviceReference reference{0, DeviceBufferImage{memory[id0].handle, memory[id0].size, 0, 0}, s.scenes[0].camera,
                                  s.features[0]};
  const DevicePair pair{0, DeviceBufferImage{memory[id1].handle, memory[id1].size, 0, 0}, {}, {}};
  fresh.record(*recording, submission.begin(), {&reference, 1}, {&pair, 1});
  submission.end();
  submission.submit_and_wait();
  const auto results = recording->read();
  ASSERT_EQ(results.size(), 1u);
  EXPECT_TRUE(same_bits(results[0], expected));
  EXPECT_TRUE(same_trace(results[0], expected));
}

TEST(LearnedMemory, APaperPairNeedsAtMost400Megabytes) {
  ICLK_NEED_DEVICE();
  std::mt19937 random(1);
  auto model = std::make_shared<Model>();
  int channels = 3;
  for (const auto& level : {std::array{16, 32, 32}, {32, 64, 64}, {64, 96, 96}, {96, 128, 128}}) {
    model->encoder.emplace_back();
    for (int out : level) {
      model->encoder.back().push_back(random_layer(channels, out, model->encoder.back().empty() ? 1 : 2, random));
      channels = out;
    }
  }
  channels = 4;
  for (const auto& [out, dilation] : {std::pair{16, 1}, {32, 2}, {64, 4}, {1, 1}}) {
    model->m_estimator.push_back(random_layer(channels, out, dilation, random));
    channels = out;
  }
  const auto bytes =
      DeviceAligner::workspace_size(*device(), plan_for({1, 1, 0, 0, 752, 480}), model->options(), Solver::device, model);
  EXPECT_LE(bytes.total(), 400'000'000u);
}

TEST(LearnedLarge, AnImageThatNoBufferHoldsIsAlignedAsOnTheCpu) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.camera = {1000, 1000, 649.5, 499.5, 1300, 1000};
  scene.T_10.t = {0.02, -0.01, 0.02};
  scene.shortest = 30;
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Features features = random_features(scene, 60);
  std::mt19937 random(3);
  auto model = odd_model();
  model->encoder = {{random_layer(3, 32, 1, random)}, {random_layer(32, 4, 2, random)}};
  const Plan plan = plan_for(scene.camera, features.size());
  const internal::Tiling tiling(*model, 1300, 1000, 2);
  ASSERT_EQ(tiling.columns.size() * tiling.rows.size(), 2u);
  const auto cpu = make_cpu_aligner(plan, options_of(*model), model);
  const auto tiled = make_device_aligner(device(), plan, options_of(*model), Solver::device, model);
  const Pair pair{0, image1.view(), {}, {}};
  std::vector<Alignment> results;
  for (Aligner* aligner : {cpu.get(), static_cast<Aligner*>(tiled.get())}) {
    aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
    results.push_back(aligner->align(pair));
  }
  EXPECT_LT(pose_difference(results[0], results[1]), 1e-5);
  EXPECT_GT((results[0].T_10.t - SE3().t).norm(), 1e-3);
}

TEST(LearnedModel, WhatDoesNotFitIsRefused) {
  ICLK_NEED_DEVICE();
  const Plan plan = plan_for({1, 1, 0, 0, 160, 120});
  const auto refused = [&](const Model& model, const AlignerOptions& options, const std::string& words) {
    try {
      make_device_aligner(device(), plan, options, Solver::device, std::make_shared<Model>(model));
      ADD_FAILURE() << "taken: " << words;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
  };
  const Model good = *odd_model();
  AlignerOptions options = options_of(good);
  options.levels = 5;
  refused(good, options, "levels is 5");
  options = options_of(good);
  options.robust = Robust::huber;
  refused(good, options, "robust weights cannot be used with this model");
  options = options_of(good);
  Model bad = good;
  bad.encoder[1][0].in = 8;
  refused(bad, options, "encoder level 1 layer 0 takes 8 channels");
  bad = good;
  bad.encoder[2][1].dilation = 0;
  refused(bad, options, "dilation of encoder level 2 layer 1 is 0");
  bad = good;
  bad.encoder[0][0].weight.pop_back();
  refused(bad, options, "134 weights");
  bad = good;
  bad.encoder[3].clear();
  refused(bad, options, "number of layers of encoder level 3 is 0");
  bad = good;
  bad.m_estimator.pop_back();
  refused(bad, options, "gives 10 channels");
  bad = good;
  bad.std[1] = 0;
  refused(bad, options, "std of channel 1");
  bad = good;
  bad.input_channels = 2;
  refused(bad, options, "input_channels is 2");
}

}  // namespace
}  // namespace iclk::test
