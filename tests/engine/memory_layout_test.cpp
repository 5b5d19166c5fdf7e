#include <iclk/engine/compute/memory_layout.h>

#include <gtest/gtest.h>

#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

constexpr VkMemoryPropertyFlags L = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, V = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT,
                                H = VK_MEMORY_PROPERTY_HOST_COHERENT_BIT, C = VK_MEMORY_PROPERTY_HOST_CACHED_BIT;

VkPhysicalDeviceMemoryProperties memory(std::initializer_list<VkMemoryPropertyFlags> types, VkDeviceSize heap = 1 << 20) {
  VkPhysicalDeviceMemoryProperties result{};
  for (VkMemoryPropertyFlags flags : types) result.memoryTypes[result.memoryTypeCount++] = {flags, flags & L ? 0u : 1u};
  result.memoryHeapCount = 2;
  result.memoryHeaps[0] = {heap, VK_MEMORY_HEAP_DEVICE_LOCAL_BIT};
  result.memoryHeaps[1] = {heap, 0};
  return result;
}

BufferDescription buffer(const char* name, MemoryKind kind) { return {name, 1, kind, BufferUse::storage, VK_FORMAT_UNDEFINED}; }

TEST(MemoryType, DiscreteGpu) {
  const auto types = memory({0, L, V | H, V | H | C, L | V | H});
  EXPECT_EQ(choose_memory_type(MemoryKind::device, ~0u, types, false), 1);
  EXPECT_EQ(choose_memory_type(MemoryKind::upload, ~0u, types, false), 2);
  EXPECT_EQ(choose_memory_type(MemoryKind::readback, ~0u, types, false), 3);
  EXPECT_EQ(choose_memory_type(MemoryKind::device, ~2u, types, false), 4) << "a type that the buffer forbids";
}

TEST(MemoryType, UnifiedMemory) {
  const auto lavapipe = memory({L | V | H | C});
  const auto integrated = memory({L, L | V | H, L | V | H | C});
  for (MemoryKind kind : {MemoryKind::device, MemoryKind::upload, MemoryKind::readback})
    EXPECT_EQ(choose_memory_type(kind, ~0u, lavapipe, true), 0);
  EXPECT_EQ(choose_memory_type(MemoryKind::device, ~0u, integrated, true), 2) << "the host reads it, too";
  EXPECT_EQ(choose_memory_type(MemoryKind::upload, ~0u, integrated, true), 1);
  EXPECT_EQ(choose_memory_type(MemoryKind::readback, ~0u, integrated, true), 2);
}

TEST(MemoryType, LazyAndUncachedMemoryIsNeverTaken) {
  const auto types = memory({L | VK_MEMORY_PROPERTY_LAZILY_ALLOCATED_BIT, L | VK_MEMORY_PROPERTY_DEVICE_COHERENT_BIT_AMD, L});
  EXPECT_EQ(choose_memory_type(MemoryKind::device, ~0u, types, false), 2);
  EXPECT_EQ(choose_memory_type(MemoryKind::upload, ~0u, types, false), -1);
}

TEST(PlaceBuffers, AlignsPacksAndSums) {
  const std::vector<BufferDescription> buffers{buffer("a", MemoryKind::device), buffer("b", MemoryKind::upload),
                                               buffer("c", MemoryKind::device), buffer("d", MemoryKind::device)};
  const std::vector<VkMemoryRequirements> needs{{100, 64, ~0u}, {48, 16, ~0u}, {256, 256, ~0u}, {16, 16, ~0u}};
  const MemoryLayout layout = place_buffers(buffers, needs, memory({L, V | H}), false, 1 << 20);
  ASSERT_EQ(layout.chunks.size(), 2u);
  EXPECT_EQ(layout.places[0].offset, 0u);
  EXPECT_EQ(layout.places[2].offset, 256u);
  EXPECT_EQ(layout.places[3].offset, 512u);
  EXPECT_EQ(layout.places[1].chunk, 1u);
  EXPECT_EQ(layout.bytes(), (MemoryBytes{528, 48, 0}));
}

TEST(PlaceBuffers, SplitsWhereOneAllocationIsTooLarge) {
  const std::vector<BufferDescription> buffers(3, buffer("a", MemoryKind::device));
  const std::vector<VkMemoryRequirements> needs(3, {100, 64, ~0u});
  const MemoryLayout layout = place_buffers(buffers, needs, memory({L}), false, 250);
  ASSERT_EQ(layout.chunks.size(), 2u);
  EXPECT_EQ(layout.chunks[0].bytes, 228u);
  EXPECT_EQ(layout.places[1].offset, 128u);
  EXPECT_EQ(layout.places[2].chunk, 1u);
  EXPECT_EQ(layout.places[2].offset, 0u);
  EXPECT_EQ(layout.bytes().device, 328u);
}

TEST(PlaceBuffers, WhatCannotBeHeldIsUnsupportedWithNumbers) {
  const auto message = [](VkDeviceSize size, VkDeviceSize most, MemoryKind kind) -> std::string {
    try {
      place_buffers({buffer("one", kind), buffer("two", kind)}, {{size, 16, ~0u}, {size, 16, ~0u}}, memory({L}), false, most);
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::unsupported);
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(message(1 << 19, 1 << 20, MemoryKind::device), "");
  EXPECT_NE(message((1 << 19) + 16, 1 << 20, MemoryKind::device).find("1048608 bytes"), std::string::npos) << "heap";
  EXPECT_NE(message(4096, 4095, MemoryKind::device).find("'one' needs 0.00 MiB (4096 bytes)"), std::string::npos)
      << "allocation";
  EXPECT_NE(message(16, 4096, MemoryKind::readback).find("no memory type"), std::string::npos);
}

}  // namespace
}  // namespace iclk::engine
