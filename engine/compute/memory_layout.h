#pragma once
// Where every buffer of a plan lies.
#include <vector>

#include <iclk/engine/compute/memory.h>

namespace iclk::engine {

struct Chunk {
  MemoryKind kind = MemoryKind::device;
  uint32_t memory_type = 0;
  VkDeviceSize bytes = 0;
  VkDeviceSize alignment = 1;  ///< the largest of its buffers'
};

struct Place {
  size_t chunk = 0;
  VkDeviceSize offset = 0;
};

struct MemoryLayout {
  std::vector<Chunk> chunks;
  std::vector<Place> places;  ///< one a buffer
  MemoryBytes bytes() const;
};

/// Packs buffers, in order, into chunks of at most `max_allocation` bytes, one run of chunks a (kind, memory type). A pure
/// function. Throws Error(unsupported) for a buffer larger than a chunk may be, a kind without a memory type, a heap that is
/// too small.
MemoryLayout place_buffers(const std::vector<BufferDescription>& buffers, const std::vector<VkMemoryRequirements>& needs,
                           const VkPhysicalDeviceMemoryProperties& memory, bool unified, VkDeviceSize max_allocation);

/// Whether memory of some type is the device's and mapped by the host.
bool has_shared_type(const VkPhysicalDeviceMemoryProperties& memory);

/// The best memory type of `allowed` (a bit a type) for a kind; -1: none.
int choose_memory_type(MemoryKind kind, uint32_t allowed, const VkPhysicalDeviceMemoryProperties& memory, bool unified);

}  // namespace iclk::engine
