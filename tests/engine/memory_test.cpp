#include <iclk/engine/compute/memory.h>

#include <algorithm>

#include <gtest/gtest.h>

#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/error.h>

#include "kernels.h"

namespace iclk::test {
namespace {

using namespace engine;

TEST(Memory, PlannedIsAllocated) {
  ICLK_NEED_DEVICE();
  MemoryPlan plan;
  plan.add("a", 1000, MemoryKind::device, BufferUse::storage | BufferUse::texel, VK_FORMAT_R32G32B32A32_SFLOAT);
  plan.add("b", 1, MemoryKind::device, BufferUse::uniform);
  plan.add("c", 77777, MemoryKind::upload, BufferUse::transfer);
  plan.add("d", 12, MemoryKind::readback, BufferUse::storage);
  const MemoryBytes planned = plan.bytes(*device());
  const Workspace memory(device(), plan);
  EXPECT_EQ(memory.bytes(), planned);
  EXPECT_GE(planned.device, 1008u + 16u);
  EXPECT_GE(planned.upload, 77777u);
  EXPECT_GE(planned.readback, 12u);
  EXPECT_LT(planned.total(), 77777u + 16384u);
}

TEST(Memory, BuffersDoNotOverlap) {
  ICLK_NEED_DEVICE();
  MemoryPlan plan;
  std::vector<BufferId> ids;
  for (int i = 0; i < 20; ++i)
    ids.push_back(plan.add("host", 100 * i + 4, i % 2 ? MemoryKind::upload : MemoryKind::readback, BufferUse::storage));
  const Workspace memory(device(), plan);
  for (size_t i = 0; i < ids.size(); ++i)
    std::fill_n(memory[ids[i]].as<uint8_t>(), memory[ids[i]].size, static_cast<uint8_t>(i + 1));
  for (size_t i = 0; i < ids.size(); ++i) {
    const Buffer& buffer = memory[ids[i]];
    EXPECT_EQ(buffer.size % 16, 0u);
    EXPECT_TRUE(std::all_of(buffer.as<uint8_t>(), buffer.as<uint8_t>() + buffer.size, [&](uint8_t v) { return v == i + 1; }))
        << i;
  }
}

TEST(Memory, TablesAreWhatTheHostWrote) {
  ICLK_NEED_DEVICE();
  MemoryPlan plan;
  const BufferId first = plan.add("first", 4000, MemoryKind::table, BufferUse::storage);
  const BufferId second = plan.add("second", 64, MemoryKind::table, BufferUse::storage);
  const BufferId seen = plan.add("seen", 4000, MemoryKind::readback, BufferUse::transfer);
  const Workspace memory(device(), plan);
  EXPECT_EQ(memory.bytes(), plan.bytes(*device()));
  EXPECT_EQ(memory[first].twin == VK_NULL_HANDLE, device()->unified_memory());
  EXPECT_GE(memory.bytes().device, 4064u);
  std::fill_n(memory[second].as<uint8_t>(), 64, uint8_t{9});
  for (uint32_t round = 1; round < 3; ++round) {
    for (uint32_t i = 0; i < 1000; ++i) memory[first].as<uint32_t>()[i] = round * i;
    Submission submission(device());
    DescriptorArena arena(device(), {});
    Recorder recorder(submission, arena);
    recorder.upload(memory[second], 0, 64);
    recorder.upload(memory[first], 0, 4000);
    recorder.copy(memory[first], memory[seen], 4000);
    recorder.host_read({&memory[seen]});
    submission.end();
    submission.submit_and_wait();
    for (uint32_t i = 0; i < 1000; ++i) ASSERT_EQ(memory[seen].as<uint32_t>()[i], round * i);
  }
}

TEST(Memory, DeviceMemoryIsMappedWhereItIsHostMemory) {
  ICLK_NEED_DEVICE();
  MemoryPlan plan;
  const BufferId id = plan.add("a", 64, MemoryKind::device, BufferUse::storage);
  const Workspace memory(device(), plan);
  if (device()->info().type == DeviceType::cpu) {
    EXPECT_NE(memory[id].mapped, nullptr);
  }
  if (device()->info().type == DeviceType::discrete) {
    EXPECT_EQ(memory[id].mapped, nullptr);
  }
}

/// The message of the Error(unsupported) in which plan and workspace of one buffer end alike.
std::string refusal(VkDeviceSize bytes, BufferUse use, VkFormat format = VK_FORMAT_UNDEFINED) {
  MemoryPlan plan;
  plan.add("huge", bytes, MemoryKind::device, use, format);
  std::string first;
  for (int i = 0; i < 2; ++i) {
    try {
      if (i)
        Workspace(device(), plan);
      else
        plan.bytes(*device());
      ADD_FAILURE() << bytes << " bytes were accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::unsupported) << error.what();
      if (i) {
        EXPECT_EQ(first, error.what());
      }
      first = error.what();
    }
  }
  return first;
}

TEST(Memory, TooLargeIsATypedErrorWithNumbers) {
  ICLK_NEED_DEVICE();
  const VkPhysicalDeviceLimits& limits = device()->limits();
  const VkDeviceSize storage = VkDeviceSize{limits.maxStorageBufferRange} + 16;
  EXPECT_NE(refusal(storage, BufferUse::storage).find("'huge' needs"), std::string::npos);
  EXPECT_NE(refusal(storage, BufferUse::storage).find("maxStorageBufferRange " + std::to_string(limits.maxStorageBufferRange)),
            std::string::npos);
  EXPECT_NE(refusal(VkDeviceSize{limits.maxUniformBufferRange} + 16, BufferUse::uniform).find("maxUniformBufferRange"),
            std::string::npos);
  const bool views = !device()->storage_reads();
  EXPECT_NE(refusal(views ? (VkDeviceSize{limits.maxTexelBufferElements} + 1) * 16 : storage, BufferUse::texel,
                    VK_FORMAT_R32G32B32A32_SFLOAT)
                .find(views ? "maxTexelBufferElements" : "maxStorageBufferRange"),
            std::string::npos);
  refusal(VkDeviceSize{1} << 62, BufferUse::transfer);
  refusal(~VkDeviceSize{0}, BufferUse::transfer);
  refusal(~VkDeviceSize{0}, BufferUse::storage);
  refusal(~VkDeviceSize{0}, BufferUse::texel, VK_FORMAT_R8_UNORM);
}

TEST(Memory, APlanBeyondTheHeapIsRefusedBeforeItIsAllocated) {
  ICLK_NEED_DEVICE();
  const VkPhysicalDeviceMemoryProperties& memory = device()->memory_properties();
  VkDeviceSize all = 0;
  for (uint32_t i = 0; i < memory.memoryHeapCount; ++i) all += memory.memoryHeaps[i].size;
  const VkDeviceSize one = std::min<VkDeviceSize>(device()->max_allocation() / 16 * 16, VkDeviceSize{1} << 30);
  MemoryPlan plan;
  for (VkDeviceSize sum = 0; sum <= all; sum += one) plan.add("part", one, MemoryKind::device, BufferUse::transfer);
  try {
    plan.bytes(*device());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unsupported);
    EXPECT_NE(std::string(error.what()).find("memory heap of the device has"), std::string::npos) << error.what();
  }
}

TEST(Memory, APlanRejectsWhatMakesNoSense) {
  MemoryPlan plan;
  EXPECT_THROW(plan.add("empty", 0, MemoryKind::device, BufferUse::storage), Error);
  EXPECT_THROW(plan.add("no format", 16, MemoryKind::device, BufferUse::texel), Error);
  EXPECT_THROW(plan.add("no format", 16, MemoryKind::device, BufferUse::image), Error);
  EXPECT_THROW(plan.add("depth", 16, MemoryKind::device, BufferUse::texel, VK_FORMAT_D16_UNORM), Error);
  EXPECT_TRUE(plan.buffers().empty());
}

TEST(Memory, MovesAndMayBeEmpty) {
  ICLK_NEED_DEVICE();
  MemoryPlan plan;
  const BufferId id = plan.add("a", 64, MemoryKind::readback, BufferUse::storage);
  Workspace one(device(), plan), two;
  const VkBuffer handle = one[id].handle;
  two = std::move(one);
  EXPECT_EQ(two[id].handle, handle);
  two = Workspace(device(), plan);
  EXPECT_NE(two[id].handle, VkBuffer{VK_NULL_HANDLE});
  EXPECT_EQ(Workspace(device(), MemoryPlan{}).bytes().total(), 0u);
}

}  // namespace
}  // namespace iclk::test
