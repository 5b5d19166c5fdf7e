#include <iclk/engine/compute/recorder.h>

#include <thread>

#include <gtest/gtest.h>

#include <iclk/engine/error.h>

#include "kernels.h"

namespace iclk::test {
namespace {

using namespace engine;

constexpr uint32_t count = 4096, workgroup = 64, spin = 20;
constexpr VkDeviceSize bytes = count * 4;

/// x -> 3 x + 1, n times.
uint32_t scaled(uint32_t x, int n) {
  while (n-- > 0) x = 3 * x + 1;
  return x;
}

class RecorderTest : public ::testing::Test {
 protected:
  void SetUp() override {
    ICLK_NEED_DEVICE();
    context = device();
    MemoryPlan plan;
    upload = plan.add("upload", bytes, MemoryKind::upload, BufferUse::transfer);
    a = plan.add("a", bytes, MemoryKind::device, BufferUse::storage);
    b = plan.add("b", bytes, MemoryKind::device, BufferUse::storage);
    readback = plan.add("readback", bytes, MemoryKind::readback, BufferUse::transfer);
    memory = Workspace(context, plan);
    scale = scale_kernel(context, workgroup);
    for (uint32_t i = 0; i < count; ++i) memory[upload].as<uint32_t>()[i] = i;
  }

  void dispatch(Recorder& recorder, BufferId id) {
    recorder.dispatch(scale, {&memory[id]}, ScalePush{count, spin}, {groups_for(count, workgroup)});
  }

  /// Expects x(i) scaled n times in the readback buffer.
  void expect_scaled(int n) {
    for (uint32_t i = 0; i < count; ++i) ASSERT_EQ(memory[readback].as<uint32_t>()[i], scaled(i, n)) << i;
  }

  std::shared_ptr<Context> context;
  Workspace memory;
  BufferId upload{}, a{}, b{}, readback{};
  Kernel scale;
};

TEST_F(RecorderTest, ToCompileIsToComputeNothing) {
  run(context, [&](Recorder& recorder) {
    recorder.copy(memory[upload], memory[a], bytes);
    recorder.compile_only();
    dispatch(recorder, a);
    recorder.copy(memory[a], memory[readback], bytes);
    recorder.host_read({&memory[readback]});
    EXPECT_EQ(recorder.dispatches(), 0u);
  });
  expect_scaled(0);
}

TEST_F(RecorderTest, ChainsOfWritesAndReads) {
  run(context, [&](Recorder& recorder) {
    recorder.copy(memory[upload], memory[a], bytes);     // transfer writes a
    for (int i = 0; i < 10; ++i) dispatch(recorder, a);  // compute reads and writes a
    recorder.copy(memory[a], memory[b], bytes);          // transfer reads a, writes b
    recorder.fill(memory[a], 0xffffffff);                // transfer writes a after reading it
    dispatch(recorder, b);
    dispatch(recorder, a);  // runs beside the dispatch before
    recorder.copy(memory[b], memory[a], bytes);
    dispatch(recorder, a);
    recorder.copy(memory[a], memory[readback], bytes);
    recorder.host_read({&memory[readback]});
    // entry, upload-a, 9 x a-a, a-copy, fill, b (settles a too), copy, a, copy, host
    EXPECT_EQ(recorder.barriers(), 1u + 1 + 9 + 1 + 1 + 1 + 1 + 1 + 1 + 1);
    EXPECT_EQ(recorder.dispatches(), 13u);
  });
  expect_scaled(12);
}

TEST_F(RecorderTest, IndependentCommandsHaveNoBarrierBetweenThem) {
  run(context, [&](Recorder& recorder) {
    recorder.fill(memory[a]);
    recorder.fill(memory[b]);
    EXPECT_EQ(recorder.barriers(), 1u);
    dispatch(recorder, a);
    dispatch(recorder, b);
    EXPECT_EQ(recorder.barriers(), 2u);
  });
}

TEST_F(RecorderTest, RegionsAndPartialFills) {
  run(context, [&](Recorder& recorder) {
    recorder.fill(memory[readback], 7);
    const VkBufferCopy regions[] = {{0, 8, 4}, {400, 16, 8}};
    recorder.copy(memory[upload], memory[readback], regions);
    recorder.fill(memory[readback], 9, 40, 4);
    recorder.host_read({&memory[readback]});
  });
  const uint32_t* words = memory[readback].as<uint32_t>();
  EXPECT_EQ(std::vector<uint32_t>(words, words + 12), (std::vector<uint32_t>{7, 7, 0, 7, 100, 101, 7, 7, 7, 7, 9, 7}));
}

TEST_F(RecorderTest, OutOfRangeIsRejected) {
  run(context, [&](Recorder& recorder) {
    EXPECT_THROW(recorder.copy(memory[upload], memory[a], bytes + 4), Error);
    const VkBufferCopy wraps{~VkDeviceSize{0} - 3, 0, 8}, beyond{0, bytes, 4}, empty{0, 0, 0};
    for (const VkBufferCopy& region : {wraps, beyond, empty})
      EXPECT_THROW(recorder.copy(memory[upload], memory[a], std::span(&region, 1)), Error);
    EXPECT_THROW(recorder.fill(memory[a], 0, 2, 4), Error);
    EXPECT_THROW(recorder.fill(memory[a], 0, bytes - 4, 8), Error);
    EXPECT_THROW(recorder.fill(memory[a], 0, bytes + 4), Error);
    EXPECT_EQ(recorder.barriers(), 0u);
  });
}

TEST_F(RecorderTest, ARecordingIsSubmittedAgainAndAgain) {
  DescriptorArena arena(context, {.sets = 1, .storage = 1});
  Submission submission(context);
  run(context, [&](Recorder& recorder) { recorder.copy(memory[upload], memory[a], bytes); });
  Recorder recorder(submission, arena);
  dispatch(recorder, a);
  recorder.copy(memory[a], memory[readback], bytes);
  recorder.host_read({&memory[readback]});
  submission.end();
  for (int n = 1; n <= 5; ++n) {
    submission.submit_and_wait();
    expect_scaled(n);
  }
  submission.submit();
  submission.submit();  // waits for the one before
  submission.wait();
  submission.wait();  // nothing is pending
  expect_scaled(7);
  submission.submit();  // and the destructor waits for this one
}

TEST_F(RecorderTest, AnArenaSharesEqualSetsAndSaysWhenItIsFull) {
  DescriptorArena arena(context, {.sets = 1, .storage = 1});
  Submission submission(context);
  Recorder recorder(submission, arena);
  for (int i = 0; i < 10; ++i) dispatch(recorder, a);
  EXPECT_EQ(arena.used(), 1u);
  try {
    dispatch(recorder, b);
    FAIL();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("arena of 1 sets"), std::string::npos) << error.what();
  }
  submission.end();
  arena.reset();
  EXPECT_EQ(arena.used(), 0u);
  Recorder again(submission, arena);
  dispatch(again, b);
  submission.end();
}

TEST_F(RecorderTest, StagesAreTimed) {
  StageTimer timer(context, 4);
  DescriptorArena arena(context, {.sets = 1, .storage = 1});
  Submission submission(context);
  Recorder recorder(submission, arena, &timer);
  recorder.stage("scale");
  for (int i = 0; i < 5; ++i) dispatch(recorder, a);
  recorder.stage("copy");
  recorder.copy(memory[a], memory[readback], bytes);
  recorder.stage("scale");
  dispatch(recorder, a);
  recorder.finish();
  submission.end();
  for (int i = 0; i < 3; ++i) {
    submission.submit_and_wait();
    timer.collect();
  }
  if (!timer.available()) GTEST_SKIP() << "this queue has no timestamps";
  ASSERT_EQ(timer.times().size(), 2u);
  EXPECT_EQ(timer.times()[0].name, "scale");
  EXPECT_EQ(timer.times()[0].count, 6);
  EXPECT_EQ(timer.times()[1].count, 3);
  EXPECT_GT(timer.times()[0].milliseconds, 0);
  EXPECT_LT(timer.times()[0].milliseconds, 60e3);
  timer.clear();
  EXPECT_TRUE(timer.times().empty());
  Recorder again(submission, arena, &timer);
  for (int i = 0; i < 4; ++i) again.stage("more");
  again.finish();
  EXPECT_THROW(again.stage("too many"), Error);
  submission.end();
}

TEST_F(RecorderTest, TwoThreadsSubmitToOneContext) {
  const auto work = [&](uint32_t seed, int* failures) {
    MemoryPlan plan;
    const BufferId data = plan.add("data", bytes, MemoryKind::readback, BufferUse::storage);
    const Workspace own(context, plan);
    const Kernel kernel = scale_kernel(context, workgroup);
    for (int round = 0; round < 50; ++round) {
      for (uint32_t i = 0; i < count; ++i) own[data].as<uint32_t>()[i] = seed + i;
      run(context, [&](Recorder& recorder) {
        recorder.dispatch(kernel, {&own[data]}, ScalePush{count, spin}, {groups_for(count, workgroup)});
        recorder.dispatch(kernel, {&own[data]}, ScalePush{count, spin}, {groups_for(count, workgroup)});
        recorder.host_read({&own[data]});
      });
      for (uint32_t i = 0; i < count; ++i) *failures += own[data].as<uint32_t>()[i] != scaled(seed + i, 2);
    }
  };
  int failures[2] = {};
  std::thread first(work, 1, &failures[0]), second(work, 100000, &failures[1]);
  first.join();
  second.join();
  EXPECT_EQ(failures[0], 0);
  EXPECT_EQ(failures[1], 0);
}

}  // namespace
}  // namespace iclk::test
