// What a watched device may not do at one go is done in parts.
#include <gtest/gtest.h>

#include "kernels.h"

namespace iclk::test {
namespace {

using namespace engine;

constexpr uint32_t kGroups = 5000;  // more than a first submission holds

std::shared_ptr<Context> watched(double longest_submission) {
  ContextOptions options = watched_options();
  options.longest_submission = longest_submission;
  return create_context(options);
}

/// Numbers scaled in one dispatch of kGroups workgroups by one submission after the other.
struct Scaled {
  std::shared_ptr<Context> context;
  BufferId data;
  Workspace memory;
  Kernel kernel;
  DescriptorArena arena;
  Submission submission;

  explicit Scaled(const std::shared_ptr<Context>& c)
      : context(c), memory(c, plan(data)), kernel(scale_kernel(c, 1)), arena(c, {.sets = 4, .storage = 8}), submission(c) {}
  static MemoryPlan plan(BufferId& data) {
    MemoryPlan plan;
    data = plan.add("data", 4 * kGroups, MemoryKind::readback, BufferUse::storage);
    return plan;
  }
  /// Whether it took more than one command buffer.
  bool run() {
    auto* values = memory[data].as<uint32_t>();
    for (uint32_t i = 0; i < kGroups; ++i) values[i] = i;
    arena.reset();
    Recorder recorder(submission, arena);
    const VkCommandBuffer first = recorder.commands();
    recorder.dispatch(kernel, {&memory[data]}, ScalePush{kGroups, 0}, {kGroups});
    const bool parts = recorder.commands() != first;
    recorder.host_read({&memory[data]});
    submission.end();
    submission.submit_and_wait();
    for (uint32_t i = 0; i < kGroups; ++i)
      if (values[i] != 3 * i + 1) {
        ADD_FAILURE() << "number " << i << " is " << values[i];
        break;
      }
    return parts;
  }
};

TEST(Submission, IsCutSmallerWhereItTakesTooLong) {
  ICLK_NEED_DEVICE();
  Scaled scaled(watched(0));
  uint64_t most = scaled.submission.most_groups();
  EXPECT_LT(most, kGroups);
  for (int i = 0; i < 5; ++i) {
    EXPECT_TRUE(scaled.run());
    EXPECT_LE(scaled.submission.most_groups(), most);
    most = scaled.submission.most_groups();
  }
  EXPECT_LE(most, 16u);
  EXPECT_GT(most, 0u);
}

TEST(Submission, IsWholeWhereTheDeviceIsFast) {
  ICLK_NEED_DEVICE();
  Scaled scaled(watched(1000));
  EXPECT_TRUE(scaled.run()) << "nothing was measured yet";
  EXPECT_FALSE(scaled.run());
}

TEST(Submission, IsWholeWhereNobodyWatches) {
  ICLK_NEED_DEVICE();
  if (device()->info().type != DeviceType::cpu) GTEST_SKIP() << "no CPU device";
  Scaled scaled(create_context(watched_options()));
  EXPECT_FALSE(scaled.run());
}

}  // namespace
}  // namespace iclk::test
