// Features that the device chooses in a depth image of the application (DeviceReference::depth), and masks that are images.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include <Eigen/Eigenvalues>

#include <iclk/align/plan/cells.h>
#include <iclk/engine/error.h>
#include <iclk/refine/device_refiner.h>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

constexpr float kInfinite = std::numeric_limits<float>::infinity();

/// An application that renders both views and the depth of the first one.
struct Rendered {
  explicit Rendered(PixelFormat format = PixelFormat::r32f) : context(app.adopt()) {
    scene.depth_amplitude = 0.1;  // or no patch has one depth
    plan = plan_for(scene.camera, 60);
    plan.format = format;
    plan.choose_features = true;
    for (int v = 0; v < 120; ++v)
      for (int u = 0; u < 160; ++u) depth.push_back(static_cast<float>(scene.depth(Eigen::Vector2d(u, v))));
  }
  DeviceImageView view_of(const std::vector<float>& values, VkFormat format = VK_FORMAT_R32_SFLOAT) {
    images.push_back(std::make_unique<ApplicationImage>(app, 160, 120, format, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL));
    if (format == VK_FORMAT_R8_UNORM) {
      std::vector<uint8_t> bytes;
      for (const float x : values) bytes.push_back(x != 0 ? 200 : 0);
      images.back()->fill(context, bytes.data(), bytes.size());
    } else {
      images.back()->fill(context, values.data(), 4 * values.size());
    }
    return {images.back()->view(), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, 160, 120, true};
  }
  DeviceImageView view_of(int which) { return view_of(render(scene, which).data); }
  DeviceReference reference(const DeviceDepth& d) { return {0, view_of(0), scene.camera, {}, d}; }

  Relief scene = moved_relief();
  Application app;
  std::shared_ptr<Context> context;
  Plan plan;
  std::vector<float> depth;
  std::vector<std::unique_ptr<ApplicationImage>> images;
};

struct Done {
  Alignment alignment;
  Features features;
  int usable() const {
    return static_cast<int>(
        std::count_if(features.inverse_depth.begin(), features.inverse_depth.end(), [](double q) { return q > 0; }));
  }
};

Done run(Rendered& r, DeviceAligner& aligner, const DeviceReference& reference) {
  const auto recording = aligner.make_recording();
  const ApplicationCommands commands(r.app);
  const DevicePair pair{0, r.view_of(1), {}, {}};
  aligner.record(*recording, commands.commands, {&reference, 1}, {&pair, 1});
  commands.end();
  for (int i = 0; i < 2; ++i) commands.submit_and_wait();  // as often as an application likes
  return {recording->read().at(0), recording->read_features().at(0)};
}

Done run(Rendered& r, const DeviceDepth& depth) {
  DeviceAligner aligner(r.context, r.plan, {}, Solver::device);
  return run(r, aligner, r.reference(depth));
}

double error_px(const Relief& scene, const SE3& T_10) {
  double most = 0;
  for (int v = 10; v < 120; v += 20)
    for (int u = 10; u < 160; u += 20) most = std::max(most, (scene.seen_from(T_10, {u, v}) - scene.truth({u, v})).norm());
  return most;
}

TEST(ChooseFeatures, OneACellWhereTextureIsWithItsDepth) {
  ICLK_NEED_DEVICE();
  Rendered r;
  const Done done = run(r, {r.view_of(r.depth)});
  const internal::Cells cells(r.plan);
  ASSERT_EQ(done.features.size(), static_cast<int>(cells.count()));
  EXPECT_GT(cells.count(), 45u);
  EXPECT_EQ(done.usable(), static_cast<int>(cells.count()));
  const Frame image = render(r.scene, 0);
  const auto texture = [&](int u, int v) {
    Eigen::Matrix2d M = Eigen::Matrix2d::Zero();
    auto at = [&](int x, int y) { return image.data[static_cast<size_t>(160 * y + x)]; };
    for (int y = v - 1; y <= v + 1; ++y)
      for (int x = u - 1; x <= u + 1; ++x) {
        const Eigen::Vector2d g(0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1)));
        M += g * g.transpose();
      }
    return Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(M).eigenvalues()(0) / 9;
  };
  for (uint32_t i = 0; i < cells.count(); ++i) {
    const Eigen::Vector2d uv = done.features.uv[i];
    const auto cell = cells[i];
    EXPECT_TRUE(uv.x() >= cell.u0 && uv.x() < cell.u1 && uv.y() >= cell.v0 && uv.y() < cell.v1) << i;
    EXPECT_NEAR(done.features.inverse_depth[i] * r.scene.depth(uv), 1, 1e-6);
    double most = 0;
    for (auto v = static_cast<int>(cell.v0); v < static_cast<int>(cell.v1); v += 2)
      for (auto u = static_cast<int>(cell.u0); u < static_cast<int>(cell.u1); u += 2) most = std::max(most, texture(u, v));
    EXPECT_NEAR(texture(static_cast<int>(uv.x()), static_cast<int>(uv.y())) / most, 1, 1e-3) << "cell " << i;
  }
  EXPECT_TRUE(done.alignment.converged()) << done.alignment.reason;
  EXPECT_LT(error_px(r.scene, done.alignment.T_10), 0.02);
}

TEST(ChooseFeatures, HostThatGivesTheSameHasTheSamePose) {
  ICLK_NEED_DEVICE();
  Rendered r;
  const Done done = run(r, {r.view_of(r.depth)});
  DeviceAligner host(r.context, plan_for(r.scene.camera, 60), {}, Solver::device);
  const Frame image0 = render(r.scene, 0), image1 = render(r.scene, 1);
  host.set_reference(0, {image0.view(), r.scene.camera, done.features, {}});
  const Alignment expected = host.align({.target = image1.view()});
  // Masks and templates are the same; the mean inverse depth, which scales last steps, is rounded once more.
  EXPECT_EQ(done.alignment.T_10.t, expected.T_10.t);
  EXPECT_EQ(done.alignment.T_10.R, expected.T_10.R);
  EXPECT_EQ(done.alignment.status, expected.status);
  EXPECT_EQ(done.alignment.features, expected.features);
}

TEST(ChooseFeatures, DepthIsReadAsTheApplicationHasIt) {
  ICLK_NEED_DEVICE();
  Rendered r;
  const Done metres = run(r, {r.view_of(r.depth)});
  const auto of = [&](auto value) {
    std::vector<float> out;
    for (const float z : r.depth) out.push_back(value(z));
    return r.view_of(out);
  };
  const auto buffer = [&](float z0, float z1) {
    return DeviceDepth::projected(of([=](float z) { return (1 / z - 1 / z0) / (1 / z1 - 1 / z0); }), z0,
                                  z1);  // of a perspective projection
  };
  const std::map<std::string, DeviceDepth> ways{
      {"millimetres", {of([](float z) { return 1000 * z; }), false, 0.001f}},
      {"inverse", {of([](float z) { return 1 / z; }), true}},
      {"a depth buffer", buffer(0.5f, 50)},
      {"reversed", buffer(50, 0.5f)},
      {"reversed without a far plane", buffer(kInfinite, 0.5f)},
  };
  for (const auto& [name, depth] : ways) {
    const Done done = run(r, depth);
    ASSERT_EQ(done.features.uv, metres.features.uv) << name;
    for (size_t i = 0; i < done.features.uv.size(); ++i)
      EXPECT_NEAR(done.features.inverse_depth[i] / metres.features.inverse_depth[i], 1, 1e-4) << name;
    EXPECT_LT(error_px(r.scene, done.alignment.T_10), 0.02) << name;
  }
}

TEST(ChooseFeatures, NoneWhereThereIsNoDepthAndEdgesLast) {
  ICLK_NEED_DEVICE();
  Rendered r;
  // Left: no depth, in all the ways there are. Right: a step in the middle of every 16 columns.
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 160; ++u) {
      float& z = r.depth[static_cast<size_t>(160 * v + u)];
      const float none[] = {0, -1, kInfinite, std::numeric_limits<float>::quiet_NaN(), 77};
      if (u < 60) z = none[(u + v) % 5];
      if (u >= 100) z *= u / 16 % 2 ? 1.0f : 0.8f;
    }
  DeviceDepth depth{r.view_of(r.depth)};
  depth.background = 77;
  const Done done = run(r, depth);
  int none = 0;
  for (size_t i = 0; i < done.features.uv.size(); ++i) {
    const Eigen::Vector2d uv = done.features.uv[i];
    if (!(done.features.inverse_depth[i] > 0)) {
      ++none;
      continue;
    }
    EXPECT_GE(uv.x(), 60);
    const int in_step = static_cast<int>(uv.x()) % 16;
    if (uv.x() >= 100 && uv.x() < 150) {
      EXPECT_TRUE(in_step >= 3 && in_step <= 11) << uv.x();  // the patch has one depth
    }
  }
  EXPECT_GT(none, 10);
  EXPECT_EQ(count_ok(done.alignment.features), done.usable());
}

TEST(ChooseFeatures, TooFewAreSaidToBe) {
  ICLK_NEED_DEVICE();
  Rendered r;
  std::fill(r.depth.begin(), r.depth.end(), 0.0f);
  const Done done = run(r, {r.view_of(r.depth)});
  EXPECT_EQ(done.usable(), 0);
  EXPECT_EQ(done.alignment.status, Status::too_few_features) << done.alignment.reason;
  EXPECT_EQ(done.alignment.T_10.t, Eigen::Vector3d::Zero());
}

TEST(ChooseFeatures, AKeyframeStaysAndMayBeReplaced) {
  ICLK_NEED_DEVICE();
  Rendered r;
  DeviceAligner aligner(r.context, r.plan, {}, Solver::device);
  const Done first = run(r, aligner, r.reference({r.view_of(r.depth)}));
  ASSERT_TRUE(first.alignment.converged());
  EXPECT_EQ(aligner.features(0).size(), 0);
  const Frame image0 = render(r.scene, 0), image1 = render(r.scene, 1);
  const Alignment again = aligner.align({.target = image1.view()});  // pixels of the host against it
  EXPECT_TRUE(same_bits(again, first.alignment)) << again.reason;
  EXPECT_EQ(again.features, first.alignment.features);

  const Features given = random_features(r.scene, 30, 1);
  aligner.set_reference(0, {image0.view(), r.scene.camera, given, {}});
  DeviceAligner other(r.context, r.plan, {}, Solver::device);
  other.set_reference(0, {image0.view(), r.scene.camera, given, {}});
  const Alignment after = aligner.align({.target = image1.view()});
  EXPECT_TRUE(same_bits(after, other.align({.target = image1.view()})));
  EXPECT_EQ(after.features.size(), 30u);
}

TEST(ChooseFeatures, ColoursAndRefinementTakeThemToo) {
  ICLK_NEED_DEVICE();
  Rendered r(PixelFormat::rgba8);
  DeviceAligner aligner(r.context, r.plan, {}, Solver::device);
  DeviceRefiner refiner(aligner);
  const auto recording = refiner.make_recording();
  const ApplicationCommands commands(r.app);
  const DeviceReference reference = r.reference({r.view_of(r.depth)});
  const DevicePair pair{0, r.view_of(1), {}, {}};
  refiner.record(*recording, commands.commands, {&reference, 1}, {&pair, 1});
  commands.end();
  commands.submit_and_wait();
  const RefinedAlignment found = recording->read().at(0);
  EXPECT_TRUE(found.converged()) << found.reason;
  EXPECT_TRUE(found.refined);
  const Features features = recording->alignment().read_features().at(0);
  EXPECT_EQ(found.inverse_depth, features.inverse_depth);
  EXPECT_EQ(found.features.size(), features.uv.size());

  // Against the same features from the host.
  DeviceAligner host(r.context, r.plan, {}, Solver::device);
  DeviceRefiner host_refiner(host);
  const auto expected = host_refiner.make_recording();
  const ApplicationCommands more(r.app);
  DeviceReference given = reference;
  given.depth.reset();
  given.features = features;
  host_refiner.record(*expected, more.commands, {&given, 1}, {&pair, 1});
  more.end();
  more.submit_and_wait();
  EXPECT_LT(error_px(r.scene, found.T_10), 0.03);
  EXPECT_LT(distance(found.T_10, expected->read().at(0).T_10, r.scene.distance), 1e-5);
}

TEST(ChooseFeatures, WhatCannotBeRecordedIsRefusedByName) {
  ICLK_NEED_DEVICE();
  Rendered r;
  const auto refused = [&](Plan plan, auto change, const std::string& part) {
    DeviceAligner aligner(r.context, plan, {}, Solver::device);
    const auto recording = aligner.make_recording();
    const ApplicationCommands commands(r.app);
    DeviceReference reference = r.reference({r.view_of(r.depth)});
    change(reference);
    const DevicePair pair{0, r.view_of(1), {}, {}};
    try {
      aligner.record(*recording, commands.commands, {&reference, 1}, {&pair, 1});
      ADD_FAILURE() << part << " was accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
    commands.end();
  };
  Plan plain = r.plan;
  plain.choose_features = false;
  refused(
      plain, [](DeviceReference&) {}, "needs a plan with choose_features");
  refused(
      r.plan, [&](DeviceReference& x) { x.features = random_features(r.scene, 5); }, "5 features and a depth image");
  refused(
      r.plan, [](DeviceReference& x) { x.depth->view.width = 80; }, "slot 0, depth: the VkImageView is 80x120");
}

TEST(MaskImages, HideWhatTheHostsMaskHides) {
  ICLK_NEED_DEVICE();
  for (const PixelFormat format : {PixelFormat::rgba8, PixelFormat::rgba32f}) {
    Rendered r(format);
    r.plan.target_masks = true;
    std::vector<uint8_t> mask(160 * 120, 255);
    for (int v = 20; v < 90; ++v) std::fill_n(mask.begin() + 160 * v + 30, 60, uint8_t{0});
    std::vector<float> shown(mask.begin(), mask.end());
    const Features features = random_features(r.scene, 60, 1);
    DeviceAligner aligner(r.context, r.plan, {}, Solver::device);
    const auto recording = aligner.make_recording();
    const ApplicationCommands commands(r.app);
    const DeviceReference reference{0, r.view_of(0), r.scene.camera, features};
    DevicePair pair{0, r.view_of(1), {}, {}};
    pair.target_mask = r.view_of(shown, VK_FORMAT_R8_UNORM);
    aligner.record(*recording, commands.commands, {&reference, 1}, {&pair, 1});
    commands.end();
    commands.submit_and_wait();
    const Alignment found = recording->read().at(0);
    EXPECT_TRUE(found.converged()) << found.reason;
    EXPECT_LT(found.visible_fraction, 0.85);

    DeviceAligner host(r.context, r.plan, {}, Solver::device);
    const Frame image0 = render(r.scene, 0), image1 = render(r.scene, 1);
    host.set_reference(0, {image0.view(), r.scene.camera, features, {}});
    Pair given{0, image1.view(), {}, {}};
    given.target_mask = {mask.data(), 160, 120, 0, PixelFormat::r8};
    const Alignment expected = host.align(given);
    // Bytes are rounded in the host's conversion and in the shader's alike, or not at all.
    EXPECT_NEAR(found.visible_fraction, expected.visible_fraction, 1e-6);
    EXPECT_LT(distance(found.T_10, expected.T_10, r.scene.distance), 1e-4);
  }
}

TEST(MaskImages, NeedAPlanForThem) {
  ICLK_NEED_DEVICE();
  Rendered r;
  DeviceAligner aligner(r.context, r.plan, {}, Solver::device);
  const auto recording = aligner.make_recording();
  const ApplicationCommands commands(r.app);
  const DeviceReference reference = r.reference({r.view_of(r.depth)});
  DevicePair pair{0, r.view_of(1), {}, {}};
  pair.target_mask = r.view_of(r.depth, VK_FORMAT_R8_UNORM);
  EXPECT_THROW(aligner.record(*recording, commands.commands, {&reference, 1}, {&pair, 1}), Error);
  commands.end();
}

}  // namespace
}  // namespace iclk::test
