#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include <iclk/engine/device_ranking.h>

namespace iclk::internal {

/// Where compiled pipelines of this device, driver and version of iclk are kept; empty where neither XDG_CACHE_HOME nor HOME is
/// an absolute path.
std::string pipeline_file(const engine::DeviceInfo& device);

/// What write_pipelines() put there: VkPipelineCache's data. Nothing where the file is missing, damaged, or not ours.
std::vector<uint8_t> read_pipelines(const std::string& file);

/// Writes the file whole or not at all, together with its folder. Throws Error(io).
void write_pipelines(const std::string& file, const std::vector<uint8_t>& data);

}  // namespace iclk::internal
