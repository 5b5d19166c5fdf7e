#pragma once
// Assigns the buffers of a plan to memory allocations.
#include <vector>

#include <iclk/engine/compute/memory.h>

namespace iclk::engine {

/// One allocation.
struct Chunk {
  MemoryKind kind = MemoryKind::device;
  uint32_t memory_type = 0;
  VkDeviceSize bytes = 0;
  VkDeviceSize alignment = 1;  ///< the largest alignment of its buffers
};

/// The position of a buffer.
struct Place {
  size_t chunk = 0;         ///< index in MemoryLayout::chunks
  VkDeviceSize offset = 0;  ///< bytes
};

struct MemoryLayout {
  std::vector<Chunk> chunks;
  std::vector<Place> places;  ///< one per buffer
  MemoryBytes bytes() const;
};

/// Packs buffers in their order into chunks of at most `max_allocation` bytes, with separate chunks for each pair of kind and
/// memory type. A pure function. Throws Error(unsupported) for a buffer larger than `max_allocation`, for a kind without a
/// memory type, and for a heap that is too small.
MemoryLayout place_buffers(const std::vector<BufferDescription>& buffers, const std::vector<VkMemoryRequirements>& needs,
                           const VkPhysicalDeviceMemoryProperties& memory, bool unified, VkDeviceSize max_allocation);

/// Whether the device has a memory type that is device local and visible to the host.
bool has_shared_type(const VkPhysicalDeviceMemoryProperties& memory);

/// The index of the best memory type for a kind among those in `allowed` (bit i: type i). -1: none.
int choose_memory_type(MemoryKind kind, uint32_t allowed, const VkPhysicalDeviceMemoryProperties& memory, bool unified);

}  // namespace iclk::engine
