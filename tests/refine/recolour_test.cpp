// Targets whose colours were changed: the grey values that fit the reference's, on the host and in shaders.
#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device_aligner.h>
#include <iclk/refine/internal/align_feature.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/refine/refiner.h>
#include <Eigen/LU>

#include "../support/synthetic.h"
#include "device.h"

namespace iclk {
namespace {

using internal::colour_sums;
using internal::ColourSums;
using internal::FeatureAlignmentTask;
using test::Scene;

/// Half a turn of a hue's way: every channel takes a part of the next one.
Eigen::Matrix3d mixing() { return (Eigen::Matrix3d() << 0.6, 0.4, 0, 0, 0.6, 0.4, 0.4, 0, 0.6).finished(); }

/// For which the mixed colours have the luma of the original ones.
Eigen::Vector3d mixed_luma() { return mixing().transpose().inverse() * Eigen::Vector3d(kLuma[0], kLuma[1], kLuma[2]); }

double angle(const GreyWeights& a, const Eigen::Vector3d& b) {
  const Eigen::Vector3d v(a[0], a[1], a[2]);
  return std::acos(std::min(1.0, v.dot(b) / (v.norm() * b.norm())));
}

/// Patches of random colours and of grey values that are `weights` of them, each patch with a gain and noise of its own.
struct Patches {
  std::mt19937 random{1};
  std::normal_distribution<double> normal;
  std::vector<ColourSums> sums;

  void add(int count, const Eigen::Vector3d& weights, double noise = 0.002, bool colourless = false) {
    for (int p = 0; p < count; ++p) {
      const double gain = 0.5 + 0.1 * (p % 10);
      Eigen::Matrix<double, 64, 3> C;
      Eigen::Matrix<double, 64, 1> T;
      for (int k = 0; k < 64; ++k) {
        for (int c = 0; c < 3; ++c) C(k, c) = 0.05 * normal(random);
        if (colourless) C.row(k).setConstant(C(k, 0));
        T[k] = gain * C.row(k).dot(weights) + noise * normal(random);
      }
      C.rowwise() -= C.colwise().mean().eval();
      T.array() -= T.mean();
      sums.push_back({T.squaredNorm(), C.transpose() * T, C.transpose() * C});
    }
  }
};

TEST(Recolour, FindsTheWeightsWhateverThePatchesGains) {
  Patches patches;
  patches.add(30, mixed_luma());
  const Recolouring found = recolour(patches.sums);
  EXPECT_TRUE(found.better());
  EXPECT_LT(angle(found.weights, mixed_luma()), 0.01);
  EXPECT_LT(found.unexplained, 0.05);
}

TEST(Recolour, WrongMatchesDoNotChoose) {
  Patches patches;
  patches.add(30, mixed_luma());
  patches.add(10, {0, 0, 1});
  patches.add(5, -mixed_luma());
  patches.sums.push_back({std::numeric_limits<double>::quiet_NaN(), {}, {}});
  patches.sums.push_back({1, {1, 1, 1}, Eigen::Matrix3d::Constant(std::numeric_limits<double>::infinity())});
  EXPECT_LT(angle(recolour(patches.sums).weights, mixed_luma()), 0.03);
}

TEST(Recolour, LumaStaysWhereNothingSpeaksForOthers) {
  const Eigen::Vector3d luma(kLuma[0], kLuma[1], kLuma[2]);
  Patches same, few, colourless, unrelated;
  same.add(30, luma);
  few.add(7, mixed_luma());
  few.sums.resize(50);  // features that were not aligned
  colourless.add(30, mixed_luma(), 0.002, true);
  unrelated.add(30, Eigen::Vector3d::Zero(), 0.05);
  for (const auto& patches : {same.sums, few.sums, colourless.sums, std::vector<ColourSums>(30), std::vector<ColourSums>()}) {
    EXPECT_FALSE(recolour(patches).better());
    EXPECT_EQ(recolour(patches).unexplained, 1);
  }
  for (const float w : recolour(unrelated.sums).weights) EXPECT_LT(std::abs(w), 10);
}

/// Three channels of textures that have nothing in common, of 8 bits, so that it is the same in every format; `mixed`: the
/// colours are changed.
struct ColourImage {
  int width, height;
  std::vector<float> data;
  ColourImage(Scene scene, int which, bool mixed) : width(scene.camera.width), height(scene.camera.height) {
    test::Picture channels[3];
    for (uint32_t c = 0; c < 3; ++c) {
      scene.seed = 10 + c;
      channels[c] = test::render(scene, which, 3 * scene.seed + c);
    }
    for (size_t i = 0; i < channels[0].data.size(); ++i) {
      Eigen::Vector3d colour(channels[0].data[i], channels[1].data[i], channels[2].data[i]);
      if (mixed) colour = mixing() * colour;
      for (int c = 0; c < 3; ++c) data.push_back(std::round(255 * std::clamp(static_cast<float>(colour[c]), 0.0f, 1.0f)) / 255);
      data.push_back(1);
    }
  }
  ImageView view() const { return {data.data(), width, height, 0, PixelFormat::rgba32f}; }
};

Scene scene_of(double roll) {
  Scene scene;
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, roll;
  scene.T_10 = SE3::exp(xi);
  scene.contrast = 0.03;  // so that 8 bits clip next to nothing
  return scene;
}

/// A pixel beside the truth.
SE3 guess(const Scene& scene) {
  Vector6d xi = Vector6d::Zero();
  xi[4] = 1 / scene.camera.fx;
  return scene.T_10 * SE3::exp(xi);
}

/// An aligner with one reference and the pairs that follow it.
struct Bench {
  Scene scene = scene_of(0.03);
  Features features = test::random_features(scene, 60, 1, 12);
  ColourImage reference{scene, 0, false}, plain{scene, 1, false}, mixed{scene, 1, true};
  Plan plan{188, 120};
  std::unique_ptr<Aligner> aligner;

  explicit Bench(Solver solver, PixelFormat format = PixelFormat::rgba32f) {
    plan.max_features = features.size();
    plan.max_pairs = 3;
    plan.format = format;
    if (solver == Solver::cpu)
      aligner = make_cpu_aligner(plan);
    else
      aligner = make_device_aligner(test::device(), plan, {}, solver);
    aligner->set_reference(0, {reference.view(), scene.camera, features, {}});
  }
  std::vector<RefinedAlignment> refine(const std::vector<const ColourImage*>& targets, const RefinerOptions& options = {}) {
    std::vector<Pair> pairs;
    for (const ColourImage* target : targets) pairs.push_back({0, target->view(), guess(scene), {}});
    return Refiner(*aligner, options).align(pairs);
  }
  double error(const RefinedAlignment& r) const {  // px, mean
    double sum = 0;
    for (const Eigen::Vector2d& uv : features.uv)
      sum += (scene.camera.project(r.T_10 * (scene.camera.ray(uv) * scene.depth(uv))) - scene.truth(uv)).norm();
    return sum / features.size();
  }
};

class RecolouredTarget : public testing::TestWithParam<Solver> {
 protected:
  void SetUp() override {
    if (GetParam() != Solver::cpu) ICLK_NEED_DEVICE();
  }
};

TEST_P(RecolouredTarget, IsSeenInTheGreyValuesOfTheReference) {
  Bench bench(GetParam());
  RefinerOptions options, without;
  options.rounds = without.rounds = 10;  // channels that have nothing in common take longer than real ones
  without.feature_alignment.recolour = false;
  const auto with = bench.refine({&bench.plain, &bench.mixed}, options),
             luma = bench.refine({&bench.plain, &bench.mixed}, without);
  for (const auto& results : {with, luma})
    for (const RefinedAlignment& r : results) ASSERT_TRUE(r.converged()) << r.reason;
  EXPECT_TRUE(with[1].recolouring.better());
  EXPECT_LT(angle(with[1].recolouring.weights, mixed_luma()), 0.03);
  EXPECT_LT(with[1].recolouring.unexplained, 0.1);
  EXPECT_NE(with[1].reason.find("converted to grey"), std::string::npos) << with[1].reason;
  // As near as where no colour was changed.
  EXPECT_LT(bench.error(with[1]), 2 * bench.error(with[0]));
  EXPECT_GT(bench.error(luma[1]), 3 * bench.error(with[1]));
  EXPECT_GT(with[1].aligned, luma[1].aligned);
  EXPECT_EQ(with[0].recolouring.weights, kLuma);
  EXPECT_EQ(luma[1].recolouring.weights, kLuma);
  EXPECT_LT(bench.error(bench.refine({&bench.mixed})[0]), 0.5 * bench.error(luma[1]));  // three rounds
  EXPECT_EQ(with[0].reason.find("converted to grey"), std::string::npos) << with[0].reason;
}

TEST_P(RecolouredTarget, EveryPairOfABatchHasItsOwnAndNoneIsKept) {
  Bench bench(GetParam());
  const auto one = [&](const ColourImage& image) { return bench.refine({&image})[0]; };
  const RefinedAlignment plain = one(bench.plain), mixed = one(bench.mixed);
  const auto batch = bench.refine({&bench.mixed, &bench.plain, &bench.mixed});
  Refiner refiner(*bench.aligner);
  std::vector<RefinedAlignment> stream;  // one refiner, whose maps stay
  for (const ColourImage* image : {&bench.mixed, &bench.plain, &bench.mixed})
    stream.push_back(refiner.align(Pair{0, image->view(), guess(bench.scene), {}}));
  for (const auto& results : {batch, stream})
    for (size_t i = 0; i < 3; ++i) {
      const RefinedAlignment& expected = i == 1 ? plain : mixed;
      EXPECT_EQ(results[i].recolouring.weights, expected.recolouring.weights) << i;
      EXPECT_EQ(results[i].T_10.t, expected.T_10.t) << i;
      EXPECT_EQ(results[i].T_10.R, expected.T_10.R) << i;
    }
}

TEST_P(RecolouredTarget, OneRoundOrOneChannelIsLuma) {
  RefinerOptions one_round;
  one_round.rounds = 1;
  Bench bench(GetParam());
  EXPECT_EQ(bench.refine({&bench.mixed}, one_round)[0].recolouring.weights, kLuma);
  if (GetParam() == Solver::cpu) return;  // has the host's pixels whatever the plan's format
  Bench grey(GetParam(), PixelFormat::r32f);
  EXPECT_EQ(grey.refine({&grey.mixed})[0].recolouring.weights, kLuma);
}

std::string solver_name(const testing::TestParamInfo<Solver>& info) {
  return info.param == Solver::cpu ? "cpu" : info.param == Solver::host ? "host" : "device";
}
INSTANTIATE_TEST_SUITE_P(Solvers, RecolouredTarget, testing::Values(Solver::cpu, Solver::host, Solver::device), solver_name);

// The definition, written down once more, where the warp moves by whole pixels.
TEST(ColourSums, AreThoseOfThePatch) {
  const Camera camera{100, 100, 15.5, 15.5, 32, 32};
  std::mt19937 random(3);
  const auto noise = [&] {
    Map map(32, 32);
    for (float& x : map.data) x = static_cast<float>(random() % 1000) / 1000;
    return map;
  };
  const Map f0 = noise();
  const std::vector<Map> rgb1{noise(), noise(), noise()};
  SE3 T_10;
  T_10.t = {0.1, 0, 0};  // 2 px at inverse depth 0.2
  const ColourSums sums = colour_sums(f0, rgb1, camera, {15.5, 12.5}, 0.2, T_10, {17.5, 12.5});
  Eigen::Matrix<double, 64, 1> T;
  Eigen::Matrix<double, 64, 3> C;
  for (int k = 0; k < 64; ++k) {
    T[k] = f0.at(12 + k % 8, 9 + k / 8);
    for (int c = 0; c < 3; ++c) C(k, c) = rgb1[static_cast<size_t>(c)].at(14 + k % 8, 9 + k / 8);
  }
  T.array() -= T.mean();
  C.rowwise() -= C.colwise().mean().eval();
  EXPECT_NEAR(sums.TT, T.squaredNorm(), 1e-9);
  EXPECT_LT((sums.TC - C.transpose() * T).norm(), 1e-9);
  EXPECT_LT((sums.CC - C.transpose() * C).norm(), 1e-9);
}

TEST(ColourSumsDevice, AgreeWithTheCpuReferenceInEveryFormat) {
  ICLK_NEED_DEVICE();
  for (const PixelFormat format : {PixelFormat::rgba8, PixelFormat::bgra8, PixelFormat::rgba32f}) {
    SCOPED_TRACE(testing::Message() << "format " << static_cast<int>(format));
    Bench cpu(Solver::cpu), device(Solver::device, format);
    std::vector<internal::AlignedFeatures> results[2];
    for (const bool on_device : {false, true}) {
      Aligner& aligner = *(on_device ? device : cpu).aligner;
      const Pair pairs[] = {{0, cpu.plain.view(), cpu.scene.T_10, {}}, {0, cpu.mixed.view(), cpu.scene.T_10, {}}};
      (void)aligner.align(pairs);
      const auto features = internal::make_feature_aligner(aligner);
      const GreyWeights weights = {0.7f, -0.1f, 0.5f};
      for (const bool recoloured : {false, true}) {
        const FeatureAlignmentTask tasks[] = {{0, 0, cpu.scene.T_10, kLuma, !recoloured},
                                              {0, 1, cpu.scene.T_10, recoloured ? weights : kLuma, true}};
        for (auto& task : features->align(tasks)) results[on_device].push_back(std::move(task));
      }
    }
    constexpr double tolerance = 1e-3;
    for (size_t task = 0; task < 4; ++task) {
      int aligned = 0;
      for (size_t i = 0; i < results[0][task].features.size(); ++i) {
        const AlignedFeature &a = results[0][task].features[i], &b = results[1][task].features[i];
        if (a.status != FeatureStatus::aligned || b.status != FeatureStatus::aligned) continue;
        ++aligned;
        EXPECT_LT((a.uv1 - b.uv1).norm(), 2e-3);
        EXPECT_EQ(results[1][task].colours.empty(), task == 2);  // was not asked for
        if (task == 2) continue;
        const ColourSums &c = results[0][task].colours[i], &d = results[1][task].colours[i];
        EXPECT_NEAR(c.TT, d.TT, tolerance * c.TT);
        EXPECT_LE((c.TC - d.TC).norm(), tolerance * std::sqrt(c.TT * c.CC.trace()));
        EXPECT_LE((c.CC - d.CC).norm(), tolerance * c.CC.norm());
      }
      EXPECT_GT(aligned, 20) << task;
    }
  }
}

}  // namespace
}  // namespace iclk
