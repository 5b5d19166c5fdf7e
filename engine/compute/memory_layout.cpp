#include <iclk/engine/compute/memory_layout.h>

#include <algorithm>
#include <array>

#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

constexpr VkMemoryPropertyFlags local = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
constexpr VkMemoryPropertyFlags visible = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
constexpr VkMemoryPropertyFlags cached = VK_MEMORY_PROPERTY_HOST_CACHED_BIT;
// Properties of memory types that are never used here.
constexpr VkMemoryPropertyFlags special = VK_MEMORY_PROPERTY_LAZILY_ALLOCATED_BIT | VK_MEMORY_PROPERTY_PROTECTED_BIT |
                                          VK_MEMORY_PROPERTY_DEVICE_COHERENT_BIT_AMD |
                                          VK_MEMORY_PROPERTY_DEVICE_UNCACHED_BIT_AMD;

struct Wish {
  VkMemoryPropertyFlags with, without;
};

/// Best first. Every conforming device has the last one of each kind.
std::vector<Wish> wishes(MemoryKind kind, bool unified) {
  switch (kind) {
    case MemoryKind::device:
      // Cached first: the host reads other memory slowly.
      if (unified) return {{local | visible | cached, 0}, {local | visible, 0}, {local, 0}};
      return {{local, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT}, {local, 0}};
    case MemoryKind::upload:
      // Not local first: the small host-visible part of a discrete GPU's memory is left to others.
      return {{visible, local | cached}, {visible, cached}, {visible, local}, {visible, 0}};
    case MemoryKind::readback: return {{visible | cached, local}, {visible | cached, 0}, {visible, 0}};
    case MemoryKind::table: break;  // a Workspace replaces it by buffers of the other kinds
  }
  return {};
}

VkDeviceSize align_up(VkDeviceSize value, VkDeviceSize alignment) { return (value + alignment - 1) / alignment * alignment; }

void check_heaps(const MemoryLayout& layout, const VkPhysicalDeviceMemoryProperties& memory) {
  std::array<VkDeviceSize, VK_MAX_MEMORY_HEAPS> sum{};
  for (const Chunk& chunk : layout.chunks) sum[memory.memoryTypes[chunk.memory_type].heapIndex] += chunk.bytes;
  for (uint32_t heap = 0; heap < memory.memoryHeapCount; ++heap)
    if (sum[heap] > memory.memoryHeaps[heap].size)
      throw Error(ErrorCode::unsupported,
                  "the plan needs " + bytes_in_words(sum[heap]) + ", but the memory heap of the device has " +
                      bytes_in_words(memory.memoryHeaps[heap].size) + "; plan smaller images or fewer pairs at a time");
}

}  // namespace

MemoryBytes MemoryLayout::bytes() const {
  MemoryBytes sum;
  for (const Chunk& chunk : chunks)
    (chunk.kind == MemoryKind::device   ? sum.device
     : chunk.kind == MemoryKind::upload ? sum.upload
                                        : sum.readback) += chunk.bytes;
  return sum;
}

bool has_shared_type(const VkPhysicalDeviceMemoryProperties& memory) {
  const int type = choose_memory_type(MemoryKind::device, ~0u, memory, true);
  return type >= 0 && (memory.memoryTypes[type].propertyFlags & visible) == visible;
}

int choose_memory_type(MemoryKind kind, uint32_t allowed, const VkPhysicalDeviceMemoryProperties& memory, bool unified) {
  for (const Wish& wish : wishes(kind, unified))
    for (uint32_t i = 0; i < memory.memoryTypeCount; ++i) {
      const VkMemoryPropertyFlags flags = memory.memoryTypes[i].propertyFlags;
      if ((allowed >> i & 1) && (flags & wish.with) == wish.with && !(flags & (wish.without | special)))
        return static_cast<int>(i);
    }
  return -1;
}

MemoryLayout place_buffers(const std::vector<BufferDescription>& buffers, const std::vector<VkMemoryRequirements>& needs,
                           const VkPhysicalDeviceMemoryProperties& memory, bool unified, VkDeviceSize max_allocation) {
  MemoryLayout layout;
  layout.places.resize(buffers.size());
  for (size_t i = 0; i < buffers.size(); ++i) {
    const BufferDescription& buffer = buffers[i];
    if (needs[i].size > max_allocation)
      throw Error(ErrorCode::unsupported, "buffer '" + buffer.name + "' needs " + bytes_in_words(needs[i].size) +
                                              ", but the device allocates at most " + bytes_in_words(max_allocation) +
                                              " at once; plan smaller images or fewer pairs at a time");
    const int type = choose_memory_type(buffer.kind, needs[i].memoryTypeBits, memory, unified);
    if (type < 0)
      throw Error(ErrorCode::unsupported,
                  "the device has no memory type for buffer '" + buffer.name + "' (" + name(buffer.kind) + ")");
    // The buffer goes into the newest chunk of its kind and type, or into a new one.
    size_t c = layout.chunks.size();
    while (c-- > 0)
      if (layout.chunks[c].kind == buffer.kind && layout.chunks[c].memory_type == static_cast<uint32_t>(type)) break;
    VkDeviceSize offset = c == SIZE_MAX ? 0 : align_up(layout.chunks[c].bytes, needs[i].alignment);
    if (c == SIZE_MAX || offset + needs[i].size > max_allocation) {
      c = layout.chunks.size();
      layout.chunks.push_back({buffer.kind, static_cast<uint32_t>(type), 0});
      offset = 0;
    }
    layout.chunks[c].bytes = offset + needs[i].size;
    layout.chunks[c].alignment = std::max(layout.chunks[c].alignment, needs[i].alignment);
    layout.places[i] = {c, offset};
  }
  check_heaps(layout, memory);
  return layout;
}

}  // namespace iclk::engine
