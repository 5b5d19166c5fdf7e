// What another pose explains as well is no claim in a command buffer either: the scenes of rivals_test.cpp, against Refiner.
#include <cstring>

#include <gtest/gtest.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/submission.h>
#include <iclk/refine/device_refiner.h>

#include "device.h"
#include "rival_scenes.h"

namespace iclk {
namespace {

using test::Frame;
using namespace test::rivals;

struct ImagePair {
  std::string name;
  Frame image0, image1;
  SE3 truth;
};

AlignerOptions aligner_options() {
  AlignerOptions options;
  options.search = true;
  return options;
}

Plan plan_of() {
  Plan plan{kCamera.width, kCamera.height};
  plan.max_features = 300;
  plan.format = PixelFormat::r32f;
  return plan;
}

RefinerOptions refiner_options() {
  RefinerOptions options;
  options.feature_alignment.recolour = false;
  return options;
}

RefinedAlignment on_host(const ImagePair& pair) {
  DeviceAligner aligner(test::device(), plan_of(), aligner_options(), Solver::device);
  Refiner refiner(aligner, refiner_options());
  aligner.set_reference(0, {pair.image0.view(), kCamera, lattice(kDistance), {}});
  return refiner.align(Pair{0, pair.image1.view(), {}, {}});
}

RefinedAlignment recorded(const ImagePair& pair) {
  engine::MemoryPlan memory_plan;
  const VkDeviceSize bytes = pair.image0.data.size() * sizeof(float);
  const auto upload = engine::MemoryKind::upload;
  const engine::BufferId ids[] = {memory_plan.add("reference", bytes, upload, engine::BufferUse::transfer),
                                  memory_plan.add("target", bytes, upload, engine::BufferUse::transfer)};
  const engine::Workspace memory(test::device(), memory_plan);
  std::memcpy(memory[ids[0]].mapped, pair.image0.data.data(), bytes);
  std::memcpy(memory[ids[1]].mapped, pair.image1.data.data(), bytes);
  const auto image = [&](int k) { return DeviceBufferImage{memory[ids[k]].handle, memory[ids[k]].size, 0, 0}; };
  DeviceAligner aligner(test::device(), plan_of(), aligner_options(), Solver::device);
  DeviceRefiner refiner(aligner, refiner_options());
  const auto recording = refiner.make_recording(1);
  const DeviceReference reference{0, image(0), kCamera, lattice(kDistance)};
  const DevicePair target{0, image(1), {}, {}};
  engine::Submission submission(test::device());
  refiner.record(*recording, submission.begin(), {&reference, 1}, {&target, 1});
  submission.end();
  submission.submit_and_wait();
  return recording->read().front();
}

ImagePair of_wall(const std::string& name, const std::function<double(double, double)>& wall, const SE3& truth) {
  return {name, render(wall, SE3(), 1), render(wall, truth, 2), truth};
}

/// The statuses are the host's; a claim is right.
void expect_alike(const ImagePair& pair) {
  SCOPED_TRACE(pair.name);
  const RefinedAlignment host = on_host(pair), device = recorded(pair);
  EXPECT_EQ(device.status, host.status) << device.reason << "\n" << host.reason;
  EXPECT_EQ(device.fixed.empty(), host.fixed.empty());
  EXPECT_EQ(device.rivals.empty(), host.rivals.empty());
  if (device.converged()) {
    EXPECT_LT(error(device.T_10, pair.truth), 1) << device.reason;
  }
  if (device.status == Status::ambiguous) {
    EXPECT_TRUE(device.covariance.isZero(0));
  }
}

TEST(DeviceRivals, WallsOfTiles) {
  ICLK_NEED_DEVICE();
  const Waves tile(kPeriod, 3), own(0, 4), poster(0, 5);
  const auto tiles = [&](double x, double y) { return 0.5 + 0.05 * tile(x, y) + 0.003 * own(x, y); };
  const auto marked = [&](double x, double y) {
    const bool inside = std::abs(x - 0.1) < 0.7 && std::abs(y) < 0.55;
    return 0.5 + (inside ? 0.05 * poster(x, y) : 0.05 * tile(x, y) + 0.015 * own(x, y));
  };
  for (const double shift : {0.3, 0.6, 0.8}) expect_alike(of_wall("tiles", tiles, sideways(shift * kPeriod, 0.1)));
  for (const double shift : {0.6, 0.8, 1.1}) expect_alike(of_wall("a poster", marked, sideways(shift * kPeriod, 0.1)));
}

TEST(DeviceRivals, WhatIsFixedToTheCamera) {
  ICLK_NEED_DEVICE();
  const Waves scene(0, 6), vehicle(0, 7);
  const auto wall = [&](double x, double y) { return 0.5 + 0.015 * scene(x, y); };
  const Frame fixed = render([&](double x, double y) { return 0.5 + 0.05 * vehicle(x, y); }, SE3(), 3);
  for (const int first : {140, 120, 100}) {  // the lower 42, 50, 58 %
    ImagePair pair = of_wall("a vehicle", wall, sideways(0.25, 0.1));
    overlay(pair.image0, fixed, first, 240);
    overlay(pair.image1, fixed, first, 240);
    expect_alike(pair);
  }
  expect_alike(of_wall(
      "a camera that stands still", [&](double x, double y) { return 0.5 + 0.05 * scene(x, y); }, SE3()));
}

TEST(DeviceRivals, WhatMovesByItself) {
  ICLK_NEED_DEVICE();
  const Waves scene(0, 6), thing(0, 8);
  const SE3 truth = sideways(0.2, 0.05), other = sideways(-0.25, -0.15);
  const auto wall = [&](double x, double y) { return 0.5 + 0.015 * scene(x, y); };
  const auto moving = [&](double x, double y) { return 0.5 + 0.05 * thing(x, y); };
  for (const double half : {0.8, 1.1}) {  // m: 18 and 34 % of the view
    ImagePair pair = of_wall("a mover", wall, truth);
    const auto inside = [&](double x, double y) { return std::abs(x) < 1.3 * half && std::abs(y) < half ? 1.0 : 0.0; };
    const auto put = [&](Frame& image, const SE3& T, uint32_t seed) {
      const Frame front = render(moving, T, seed), mask = render(inside, T, 0);
      for (size_t i = 0; i < image.data.size(); ++i)
        if (mask.data[i] > 0.5f) image.data[i] = front.data[i];
    };
    put(pair.image0, SE3(), 11);
    put(pair.image1, other, 12);
    expect_alike(pair);
  }
}

}  // namespace
}  // namespace iclk
