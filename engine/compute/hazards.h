#pragma once
// Decides which barrier a command needs. Makes no Vulkan calls, so that its tests need no device.
#include <cstdint>
#include <optional>
#include <span>
#include <unordered_map>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// The pipeline stages in which a recording accesses memory. Values are bits.
enum class Stage : uint8_t { compute = 1, transfer = 2, host = 4 };

/// An access of a command to a buffer.
struct Use {
  uint64_t resource = 0;  ///< the VkBuffer
  bool write = false;
};

/// One VkMemoryBarrier.
struct Barrier {
  VkPipelineStageFlags source_stages = 0, destination_stages = 0;
  VkAccessFlags source_access = 0, destination_access = 0;
};

/// Tracks the memory accesses of one recording, command by command. A VkMemoryBarrier orders all earlier accesses of its
/// stages, so one barrier serves all buffers. Earlier work on the queue is unknown: the first command of the recording waits
/// for all earlier compute and transfer work.
class HazardTracker {
 public:
  /// Adds a command of `stage` with these uses. Returns the barrier that must precede it, or nothing if it needs none.
  std::optional<Barrier> before(Stage stage, std::span<const Use> uses);

 private:
  struct State {
    uint8_t write = 0;            // the stage of the last write; 0: none in this recording
    uint8_t write_seen = 0;       // stages to which that write is visible
    uint8_t read = 0;             // stages that have read since that write
    uint8_t read_before[2] = {};  // stages that wait for those reads; [0]: reads of compute, [1]: of transfer
  };

  void settle(uint8_t sources, bool writes, uint8_t destinations);

  std::unordered_map<uint64_t, State> states_;
  bool first_ = true;
};

}  // namespace iclk::engine
