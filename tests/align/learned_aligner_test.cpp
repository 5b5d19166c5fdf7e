// Learned models through the CPU aligner: dense mode, constant weights, images that are none.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include <iclk/align/cpu/cpu_aligner.h>

#include "random_model.h"
#include "relief.h"

namespace iclk {
namespace {

using test::Frame;
using test::Relief;

struct Scene {
  Relief relief;
  Frame image0, image1;
  Features features;
  Frame inverse_depth;

  Scene() {
    relief.T_10 = SE3::exp((Vector6d() << 0.02, -0.01, 0.01, 0.004, -0.003, 0.005).finished());
    image0 = test::render(relief, 0);
    image1 = test::render(relief, 1);
    features = test::random_features(relief, 30);
    inverse_depth = test::inverse_depth_frame(relief);
  }
};

Alignment run(const Scene& scene, const Model& model, bool dense, AlignerOptions options) {
  Plan plan{scene.relief.camera.width, scene.relief.camera.height};
  plan.dense = dense;
  CpuAligner aligner(plan, options, std::make_shared<Model>(model));
  aligner.set_reference(0, {scene.image0.view(), scene.relief.camera, scene.features, scene.inverse_depth.view()});
  return aligner.align(Pair{0, scene.image1.view(), {}, {}});
}

/// An encoder that is nearly the grey image: the centre tap of its only channel, in the range where ELU is straight.
Model identity_model(int levels) {
  Model model = test::random_model(std::vector<std::vector<int>>(static_cast<size_t>(levels), {1}), 1);
  for (auto& level : model.encoder) {
    std::fill(level[0].weight.begin(), level[0].weight.end(), 0.0f);
    level[0].weight[4] = 1;
    level[0].bias[0] = 0;
  }
  model.mean = {-1, 0, 0};
  model.std = {1, 1, 1};
  return model;
}

TEST(LearnedAligner, AnEncoderThatIsTheGreyImageGivesTheClassicalPose) {
  const Scene scene;
  Model model = identity_model(3);
  model.m_estimator.clear();
  for (const bool dense : {false, true}) {
    const Alignment learned = run(scene, model, dense, model.options());
    Plan plan{scene.relief.camera.width, scene.relief.camera.height};
    plan.dense = dense;
    CpuAligner classical(plan, model.options());
    classical.set_reference(0, {scene.image0.view(), scene.relief.camera, scene.features, scene.inverse_depth.view()});
    const Alignment expected = classical.align(Pair{0, scene.image1.view(), {}, {}});
    EXPECT_TRUE(learned.converged()) << learned.reason;
    EXPECT_LT((learned.T_10.matrix() - expected.T_10.matrix()).norm(), 1e-5);
    EXPECT_LT((learned.T_10.matrix() - scene.relief.T_10.matrix()).norm(), 0.01);
  }
}

TEST(LearnedAligner, ConstantWeightsChangeNothingButTheScale) {
  const Scene scene;
  Model half = identity_model(2), none = half;
  none.m_estimator.clear();
  for (ConvLayer& layer : half.m_estimator) {
    std::fill(layer.weight.begin(), layer.weight.end(), 0.0f);
    std::fill(layer.bias.begin(), layer.bias.end(), 0.0f);
  }
  AlignerOptions options = half.options();
  options.step_tolerance = 0;  // a pixel that is seen only later has no weight: the same number of steps for both
  for (const bool dense : {false, true}) {
    const Alignment a = run(scene, half, dense, options), b = run(scene, none, dense, options);
    EXPECT_LT((a.T_10.matrix() - b.T_10.matrix()).norm(), dense ? 1e-3 : 1e-6);
    EXPECT_LT((2 * a.H - b.H).norm(), (dense ? 0.05 : 1e-4) * b.H.norm());
  }
}

TEST(LearnedAligner, FewerLevelsOfADeeperModel) {
  const Scene scene;
  const Model three = identity_model(3);
  Model two = three;
  two.encoder.pop_back();
  AlignerOptions options = three.options();
  options.levels = 2;
  const Alignment a = run(scene, three, false, options), b = run(scene, two, false, options);
  ASSERT_EQ(a.levels.size(), 2u);
  EXPECT_EQ(a.T_10.matrix(), b.T_10.matrix());
}

TEST(LearnedAligner, PixelsThatAreNoNumbersEndInAStatus) {
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  for (const float value : {nan, inf, -inf, 3e38f}) {
    Scene scene;
    scene.image1.at(80, 60) = value;
    const Model model = test::random_model({{4, 4}, {4, 4}});
    const Alignment a = run(scene, model, false, model.options());
    EXPECT_TRUE(a.T_10.matrix().allFinite()) << value;
    for (float& x : scene.image1.data) x = value;
    const Alignment all = run(scene, model, false, model.options());
    EXPECT_FALSE(all.converged()) << value;
    EXPECT_TRUE(all.T_10.matrix().allFinite()) << value;
  }
}

}  // namespace
}  // namespace iclk
