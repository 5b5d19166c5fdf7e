#include <iclk/engine/compute/hazards.h>

namespace iclk::engine {
namespace {

constexpr uint8_t compute = static_cast<uint8_t>(Stage::compute), transfer = static_cast<uint8_t>(Stage::transfer),
                  host = static_cast<uint8_t>(Stage::host);

VkFlags flags_of(uint8_t stages, VkFlags of_compute, VkFlags of_transfer, VkFlags of_host) {
  VkFlags flags = 0;
  if (stages & compute) flags |= of_compute;
  if (stages & transfer) flags |= of_transfer;
  if (stages & host) flags |= of_host;
  return flags;
}

VkPipelineStageFlags stage_flags(uint8_t stages) {
  return flags_of(stages, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT);
}

VkAccessFlags write_access(uint8_t stages) {
  return flags_of(stages, VK_ACCESS_SHADER_WRITE_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_ACCESS_HOST_WRITE_BIT);
}

VkAccessFlags all_access(uint8_t stages) {
  return flags_of(stages, VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_UNIFORM_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT,
                  VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT, VK_ACCESS_HOST_READ_BIT);
}

}  // namespace

std::optional<Barrier> HazardTracker::before(Stage stage, std::span<const Use> uses) {
  const auto at = static_cast<uint8_t>(stage);
  uint8_t write_sources = 0, read_sources = 0;
  for (const Use& use : uses) {
    const State& state = states_[use.resource];
    if (state.write && !(state.write_seen & at)) write_sources |= state.write;
    if (!use.write) continue;
    for (int i = 0; i < 2; ++i)
      if ((state.read >> i & 1) && !(state.read_before[i] & at)) read_sources |= static_cast<uint8_t>(1u << i);
  }
  std::optional<Barrier> barrier;
  if (first_) {
    const uint8_t device = compute | transfer, destination = device | at;
    barrier = Barrier{stage_flags(device), stage_flags(destination), write_access(device), all_access(destination)};
    first_ = false;
  } else if (write_sources | read_sources) {
    const auto sources = static_cast<uint8_t>(write_sources | read_sources);
    const bool writes = write_sources != 0;  // a write after a read needs an execution dependency only
    barrier = Barrier{stage_flags(sources), stage_flags(at), writes ? write_access(sources) : 0, writes ? all_access(at) : 0};
    settle(sources, writes, at);
  }

  for (const Use& use : uses) {
    State& state = states_[use.resource];
    state.read |= at;
    for (int i = 0; i < 2; ++i)
      if (at >> i & 1) state.read_before[i] = 0;
  }
  for (const Use& use : uses)  // after the reads, because a buffer that one command reads and writes counts as written
    if (use.write) states_[use.resource] = {at, 0, 0, {}};
  return barrier;
}

void HazardTracker::settle(uint8_t sources, bool writes, uint8_t destinations) {
  for (auto& [resource, state] : states_) {
    if (writes && (state.write & sources)) state.write_seen |= destinations;
    for (int i = 0; i < 2; ++i)
      if ((state.read & sources) >> i & 1) state.read_before[i] |= destinations;
  }
}

}  // namespace iclk::engine
