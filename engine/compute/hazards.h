#pragma once
// Which barrier a command needs. Knows no Vulkan object; tested without a device.
#include <cstdint>
#include <optional>
#include <span>
#include <unordered_map>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// The three places where a recording touches memory. Values are bits.
enum class Stage : uint8_t { compute = 1, transfer = 2, host = 4 };

struct Use {
  uint64_t resource = 0;  ///< the VkBuffer
  bool write = false;
};

/// One VkMemoryBarrier.
struct Barrier {
  VkPipelineStageFlags source_stages = 0, destination_stages = 0;
  VkAccessFlags source_access = 0, destination_access = 0;
};

/// Follows one recording, command by command. A VkMemoryBarrier orders everything before it, whatever the buffer, so each
/// barrier settles all other buffers of the same stages too. What happened before the recording is unknown: its first command
/// waits for the compute and transfer work before it, once.
class HazardTracker {
 public:
  /// The barrier that must stand before a command of `stage` with these uses; nothing if none is needed. Notes the command.
  std::optional<Barrier> before(Stage stage, std::span<const Use> uses);

 private:
  struct State {
    uint8_t write = 0;            // the stage of the last write, 0: none in this recording
    uint8_t write_seen = 0;       // stages that see it
    uint8_t read = 0;             // stages that read since that write
    uint8_t read_before[2] = {};  // stages that wait for those reads, by reading stage: compute, transfer
  };

  void settle(uint8_t sources, bool writes, uint8_t destinations);

  std::unordered_map<uint64_t, State> states_;
  bool first_ = true;
};

}  // namespace iclk::engine
