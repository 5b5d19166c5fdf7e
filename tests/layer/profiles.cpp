// Figures as devices of these kinds report them (vulkan.gpuinfo.org); sizes of heaps are those of a small one. `floor` is the
// table of required limits of Vulkan 1.1 but for storage buffers a stage, of which it promises 4 and iclk needs 11.
#include "profiles.h"

namespace iclk::test {
namespace {

constexpr uint64_t MiB = uint64_t{1} << 20, GiB = uint64_t{1} << 30;
constexpr VkMemoryPropertyFlags local = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, visible = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT,
                                coherent = VK_MEMORY_PROPERTY_HOST_COHERENT_BIT, cached = VK_MEMORY_PROPERTY_HOST_CACHED_BIT,
                                odd = VK_MEMORY_PROPERTY_DEVICE_COHERENT_BIT_AMD | VK_MEMORY_PROPERTY_DEVICE_UNCACHED_BIT_AMD;
constexpr VkSubgroupFeatureFlags basic = VK_SUBGROUP_FEATURE_BASIC_BIT,
                                 some = basic | VK_SUBGROUP_FEATURE_VOTE_BIT | VK_SUBGROUP_FEATURE_ARITHMETIC_BIT |
                                        VK_SUBGROUP_FEATURE_BALLOT_BIT,
                                 all = some | VK_SUBGROUP_FEATURE_SHUFFLE_BIT | VK_SUBGROUP_FEATURE_SHUFFLE_RELATIVE_BIT |
                                       VK_SUBGROUP_FEATURE_CLUSTERED_BIT | VK_SUBGROUP_FEATURE_QUAD_BIT;
constexpr VkPhysicalDeviceType discrete = VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU,
                               integrated = VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU;
constexpr VkMemoryHeapFlags device = VK_MEMORY_HEAP_DEVICE_LOCAL_BIT;
constexpr uint32_t v1_1 = VK_API_VERSION_1_1, v1_3 = VK_API_VERSION_1_3;

std::vector<Profile> make() {
  // clang-format off
  return {
      {"floor", discrete, 0x1, v1_1, 65536, 128, 16384, 11, 128, 128 * MiB, GiB, 256, 256, 256, basic, false, false,
       {{GiB, device}, {GiB, 0}},
       {{local, 0}, {visible | cached, 1}, {visible | coherent, 1}}},
      // Turing and later, without a resizable BAR.
      {"nvidia", discrete, 0x10de, v1_3, 1u << 27, 1024, 49152, 1u << 20, 256, 4 * GiB - 1, 4 * GiB, 16, 16, 64, all, true,
       false,
       {{8 * GiB, device}, {16 * GiB, 0}, {256 * MiB, device}},
       {{0, 1}, {local, 0}, {visible | coherent, 1}, {visible | coherent | cached, 1}, {local | visible | coherent, 2}},
       true},
      // RDNA 2, RADV; the order is that of its types, the uncached ones last.
      {"amd", discrete, 0x1002, v1_3, UINT32_MAX, 1024, 65536, 1u << 23, 256, 4 * GiB - 1, 4 * GiB, 4, 4, 64, all, true, false,
       {{16 * GiB, 0}, {8 * GiB - 256 * MiB, device}, {256 * MiB, device}},
       {{local, 1}, {visible | coherent, 0}, {local | visible | coherent, 2}, {visible | coherent | cached, 0},
        {local | odd, 1}, {visible | coherent | odd, 0}, {local | visible | coherent | odd, 2},
        {visible | coherent | cached | odd, 0}}},
      // Xe: everything is local, and what is not cached comes first.
      {"intel", integrated, 0x8086, v1_3, 1u << 27, 1024, 65536, 200, 256, GiB, 4 * GiB, 4, 16, 64, all, true, false,
       {{8 * GiB, device}},
       {{local, 0}, {local | visible | coherent, 0}, {local | visible | coherent | cached, 0}}},
      // Apple M1 through MoltenVK.
      {"moltenvk", integrated, 0x106b, v1_1, 1u << 26, 1024, 32768, 31, 4096, 4 * GiB - 1, 4 * GiB, 16, 256, 16, all, true,
       true,
       {{8 * GiB, device}},
       {{local, 0}, {local | visible | cached, 0}, {local | visible | coherent | cached, 0}}},
      // Adreno 6xx, Qualcomm's driver.
      {"adreno", integrated, 0x5143, v1_1, 65536, 1024, 32768, 24, 256, 2 * GiB - 1, 2 * GiB, 64, 64, 64, some, true, false,
       {{4 * GiB, device}},
       {{local, 0}, {local | visible | cached, 0}, {local | visible | coherent, 0}, {local | visible | coherent | cached, 0}}},
      // Mali-G76.
      {"mali-bifrost", integrated, 0x13b5, v1_1, 65536, 384, 32768, 35, 128, 512 * MiB, 4 * GiB, 16, 64, 64, basic, false,
       false,
       {{4 * GiB, device}},
       {{local | visible | cached, 0}, {local | visible | coherent, 0}, {local | visible | coherent | cached, 0}}},
      // Mali-G610.
      {"mali-valhall", integrated, 0x13b5, v1_3, 1u << 26, 512, 32768, 500000, 256, 4 * GiB - 1, 4 * GiB, 16, 64, 64, some,
       true, false,
       {{4 * GiB, device}},
       {{local | visible | coherent, 0}, {local | visible | cached, 0}, {local | visible | coherent | cached, 0}}},
      // VideoCore VI of the Raspberry Pi 4, Mesa.
      {"v3d", integrated, 0x14e4, v1_1, 1u << 24, 256, 16384, 8, 128, GiB, GiB, 32, 32, 256, basic, true, false,
       {{2 * GiB, device}},
       {{local | visible | coherent, 0}}},
  };
  // clang-format on
}

}  // namespace

const std::vector<Profile>& profiles() {
  static const std::vector<Profile> all = make();
  return all;
}

const Profile* profile(const std::string& name) {
  for (const Profile& each : profiles())
    if (name == each.name) return &each;
  return nullptr;
}

}  // namespace iclk::test
