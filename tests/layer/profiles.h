#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include <vulkan/vulkan_core.h>

namespace iclk::test {

/// What a device of another maker says of itself, as far as computing goes.
struct Profile {
  const char* name;  ///< of ICLK_TEST_DEVICE
  VkPhysicalDeviceType type;
  uint32_t vendor;
  uint32_t api_version;
  uint32_t texel_elements, invocations, shared_memory, storage_buffers, push_constants;
  uint64_t storage_range;
  uint64_t allocation;  ///< bytes of one vkAllocateMemory
  uint32_t storage_alignment, texel_alignment, atom;
  VkSubgroupFeatureFlags subgroup;
  bool timestamps, portability_subset;
  std::vector<VkMemoryHeap> heaps;
  std::vector<VkMemoryType> types;
  bool rounds_as_gpus = false;  ///< arithmetic.h; three times as slow
};

const std::vector<Profile>& profiles();

/// Null where there is none of that name.
const Profile* profile(const std::string& name);

}  // namespace iclk::test
