// Pair::target_mask: what it hides counts nowhere, whatever lies there.
#include <limits>

#include <iclk/engine/error.h>
#include <iclk/refine/refiner.h>

#include "random_model.h"
#include "solvers.h"

namespace iclk::test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct Mask {
  Mask(int width, int height)
      : width(width), height(height), data(static_cast<size_t>(width) * static_cast<size_t>(height), 255) {}
  void hide(int u0, int v0, int u1, int v1) {
    for (int v = v0; v < v1; ++v) std::fill_n(data.begin() + static_cast<long>(v) * width + u0, u1 - u0, uint8_t{0});
  }
  bool hides(int u, int v) const {
    return data[static_cast<size_t>(v) * static_cast<size_t>(width) + static_cast<size_t>(u)] == 0;
  }
  ImageView view() const { return {data.data(), width, height, 0, PixelFormat::r8}; }
  int width, height;
  std::vector<uint8_t> data;
};

/// A target in which something else moves: a third of it shows a texture of its own.
struct Occluded {
  Occluded() : scene(moved_relief()), mask(scene.camera.width, scene.camera.height) {
    features = random_features(scene, 60);
    image0 = render(scene, 0);
    image1 = render(scene, 1);
    clean = image1;
    Relief other = scene;
    other.seed = 7;
    other.T_10 = {};
    const Frame foreign = render(other, 0);
    mask.hide(30, 20, 100, 100);
    for (int v = 0; v < mask.height; ++v)
      for (int u = 0; u < mask.width; ++u)
        if (mask.hides(u, v))
          image1.data[static_cast<size_t>(v * mask.width + u)] = foreign.data[static_cast<size_t>(v * mask.width + u)];
  }
  Frame with(float value) const {
    Frame image = image1;
    for (size_t i = 0; i < image.data.size(); ++i)
      if (mask.data[i] == 0) image.data[i] = value;
    return image;
  }
  Reference reference() const { return {image0.view(), scene.camera, features, {}}; }
  Relief scene;
  Mask mask;
  Features features;
  Frame image0, image1, clean;
};

Plan masked_plan(const Camera& camera, int features = 60) {
  Plan plan = plan_for(camera, features);
  plan.format = PixelFormat::rgba32f;
  plan.target_masks = true;
  return plan;
}

Pair masked(const Frame& target, const Mask& mask) {
  Pair pair{0, target.view(), {}, {}};
  pair.target_mask = mask.view();
  return pair;
}

class TargetMask : public Solvers {
 protected:
  Alignment align(const Reference& reference, const Pair& pair, const AlignerOptions& options = {}) const {
    const auto aligner = make_aligner(way(), masked_plan(reference.camera), options);
    aligner->set_reference(0, reference);
    return aligner->align(pair);
  }
  const Occluded scene_;
};

TEST_P(TargetMask, WhatMovesByItselfIsLeftOut) {
  AlignerOptions options;
  options.robust = Robust::unit;  // nothing else keeps it out
  const Alignment with = align(scene_.reference(), masked(scene_.image1, scene_.mask), options);
  const Alignment without = align(scene_.reference(), Pair{0, scene_.image1.view(), {}, {}}, options);
  EXPECT_EQ(with.status, Status::converged) << with.reason;
  EXPECT_LT(pixel_error(scene_.scene, scene_.features, with.T_10), 0.03);
  EXPECT_GT(pixel_error(scene_.scene, scene_.features, without.T_10), 0.3) << "the scene is too easy to show anything";
}

TEST_P(TargetMask, WhatLiesUnderItIsNotRead) {
  for (const Robust robust : {Robust::unit, Robust::huber}) {
    AlignerOptions options;
    options.robust = robust;
    const Alignment zeros = align(scene_.reference(), masked(scene_.with(0), scene_.mask), options);
    EXPECT_EQ(zeros.status, Status::converged) << zeros.reason;
    for (const float value : {1.0f, -1e6f, kNan, std::numeric_limits<float>::infinity()})
      EXPECT_TRUE(same_bits(zeros, align(scene_.reference(), masked(scene_.with(value), scene_.mask), options))) << value;
  }
}

TEST_P(TargetMask, WithoutOneEverythingIsVisible) {
  const auto plain = align_once(way(), scene_.scene, scene_.image0, scene_.clean, scene_.features);
  const Alignment open = align(scene_.reference(), Pair{0, scene_.clean.view(), {}, {}});
  const Alignment white = align(scene_.reference(), masked(scene_.clean, Mask(scene_.mask.width, scene_.mask.height)));
  EXPECT_TRUE(same_bits(open, white));
  EXPECT_LT(distance(plain.T_10, open.T_10, scene_.scene.distance), 1e-5);
  EXPECT_NEAR(plain.visible_fraction, open.visible_fraction, 1e-3);
}

TEST_P(TargetMask, HiddenPixelsAreNotVisibleOnes) {
  const Alignment open = align(scene_.reference(), masked(scene_.clean, Mask(scene_.mask.width, scene_.mask.height)));
  const Alignment some = align(scene_.reference(), masked(scene_.clean, scene_.mask));
  EXPECT_LT(some.visible_fraction, open.visible_fraction - 0.15);
  Mask all(scene_.mask.width, scene_.mask.height);
  all.hide(0, 0, all.width, all.height);
  const Alignment none = align(scene_.reference(), masked(scene_.clean, all));
  EXPECT_EQ(none.status, Status::low_overlap) << none.reason;
  EXPECT_EQ(none.visible_fraction, 0);
}

TEST_P(TargetMask, OfEachPairItsOwn) {
  Plan plan = masked_plan(scene_.scene.camera);
  plan.max_pairs = 3;
  const auto aligner = make_aligner(way(), plan);
  aligner->set_reference(0, scene_.reference());
  const Frame unknown = scene_.with(kNan);
  const std::vector<Pair> pairs = {masked(scene_.image1, scene_.mask), Pair{0, scene_.clean.view(), {}, {}},
                                   masked(unknown, scene_.mask)};
  const std::vector<Alignment> together = aligner->align(pairs);
  for (size_t i = 0; i < pairs.size(); ++i) EXPECT_TRUE(same_bits(together[i], align(scene_.reference(), pairs[i]))) << i;
  EXPECT_GT(together[1].visible_fraction, together[0].visible_fraction + 0.1);
}

// Matching must not find the reference's patches in what is hidden: there most of the image lies, far from where it belongs.
TEST_P(TargetMask, StartsAreNotMatchedUnderIt) {
  const auto turned = [](double angle) {
    Relief scene;
    scene.T_10 = SE3::exp((Vector6d() << 0, 0, 0, 0, angle, 0).finished());
    return scene;
  };
  const Relief scene = turned(0.3);  // 40 px
  const Features features = random_features(scene, 60);
  const Frame image0 = render(scene, 0), elsewhere = render(turned(-0.35), 1);
  Frame image1 = render(scene, 1);
  Mask mask(image1.width, image1.height);
  mask.hide(0, 0, 95, image1.height);
  for (size_t i = 0; i < image1.data.size(); ++i)
    if (mask.data[i] == 0) image1.data[i] = elsewhere.data[i];
  AlignerOptions options;
  options.search = true;
  const Alignment a = align({image0.view(), scene.camera, features, {}}, masked(image1, mask), options);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_LT(pixel_error(scene, features, a.T_10), 0.1);
}

TEST_P(TargetMask, RefinementLeavesHiddenFeaturesOut) {
  const auto aligner = make_aligner(way(), masked_plan(scene_.scene.camera));
  aligner->set_reference(0, scene_.reference());
  Refiner refiner(*aligner);
  const RefinedAlignment r = refiner.align(masked(scene_.with(kNan), scene_.mask));
  EXPECT_EQ(r.status, Status::converged) << r.reason;
  EXPECT_LT(pixel_error(scene_.scene, scene_.features, r.T_10), 0.03);
  int hidden = 0;
  for (size_t i = 0; i < r.features.size(); ++i) {
    const Eigen::Vector2d at = scene_.scene.truth(scene_.features.uv[i]);
    const int u = static_cast<int>(std::lround(at.x())), v = static_cast<int>(std::lround(at.y()));
    if (u < 4 || v < 4 || u >= scene_.mask.width - 4 || v >= scene_.mask.height - 4) continue;
    if (!scene_.mask.hides(u, v)) continue;
    EXPECT_EQ(r.features[i].status, FeatureStatus::hidden) << at.transpose();
    ++hidden;
  }
  EXPECT_GT(hidden, 5);
  EXPECT_NE(r.reason.find("of " + std::to_string(r.visible) + " visible"), std::string::npos) << r.reason;
  EXPECT_LE(r.visible, scene_.features.size() - hidden);
}

TEST_P(TargetMask, BadOnesAreRefused) {
  const auto aligner = make_aligner(way(), masked_plan(scene_.scene.camera));
  aligner->set_reference(0, scene_.reference());
  const auto message = [&](Aligner& a, const Pair& pair) -> std::string {
    try {
      a.align(pair);
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::invalid_argument);
      return e.what();
    }
    return "no error";
  };
  EXPECT_NE(message(*aligner, masked(scene_.clean, Mask(10, 10))).find("target mask is 10x10"), std::string::npos);
  Pair floats = masked(scene_.clean, scene_.mask);
  floats.target_mask = scene_.clean.view();
  EXPECT_NE(message(*aligner, floats).find("format r8"), std::string::npos);
  const auto plain = make_aligner(way(), plan_for(scene_.scene.camera, 60));
  plain->set_reference(0, scene_.reference());
  EXPECT_NE(message(*plain, masked(scene_.clean, scene_.mask)).find("target_masks"), std::string::npos);
}

INSTANTIATE_TEST_SUITE_P(All, TargetMask, testing::Values(Way::cpu, Way::host, Way::device), way_name);

// On maps of an encoder, and in eight bits as well.
TEST(LearnedTargetMask, IsTheCpuReferences) {
  ICLK_NEED_DEVICE();
  const Occluded scene;
  const auto model = std::make_shared<const Model>(random_model({{8, 8, 8}, {8, 8, 8}, {8, 8, 8}}));
  AlignerOptions options = model->options();
  options.step_tolerance = 0;
  options.iterations = 4;
  for (const PixelFormat format : {PixelFormat::rgba32f, PixelFormat::rgba8, PixelFormat::bgra8}) {
    Plan plan = masked_plan(scene.scene.camera);
    plan.format = format;
    const auto run = [&](Aligner& aligner) {
      aligner.set_reference(0, scene.reference());
      return aligner.align(masked(scene.image1, scene.mask));
    };
    const Alignment cpu = run(*make_cpu_aligner(plan, options, model));
    for (const Solver solver : {Solver::host, Solver::device}) {
      const Alignment a = run(*make_device_aligner(device(), plan, options, solver, model));
      EXPECT_NEAR(a.visible_fraction, cpu.visible_fraction, 2e-3);
      EXPECT_LT(distance(a.T_10, cpu.T_10, scene.scene.distance), format == PixelFormat::rgba32f ? 1e-4 : 1e-2);
    }
  }
}

TEST(TargetMaskPlan, NeedsAnAlphaOnADevice) {
  ICLK_NEED_DEVICE();
  Plan plan = masked_plan({130, 130, 79.5, 59.5, 160, 120});
  plan.format = PixelFormat::r8;
  EXPECT_THROW(make_device_aligner(device(), plan), Error);
  EXPECT_NO_THROW(make_cpu_aligner(plan));
}

}  // namespace
}  // namespace iclk::test
