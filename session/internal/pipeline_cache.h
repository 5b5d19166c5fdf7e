#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include <iclk/engine/device_ranking.h>

namespace iclk::internal {

/// The file of compiled pipelines for this device, driver and version of iclk. Empty if neither XDG_CACHE_HOME nor HOME is an
/// absolute path.
std::string pipeline_file(const engine::DeviceInfo& device);

/// Reads the VkPipelineCache data that write_pipelines() wrote. Empty if the file is missing, damaged, or of another origin.
std::vector<uint8_t> read_pipelines(const std::string& file);

/// Writes the file completely or not at all, and makes its folder. Throws Error(io).
void write_pipelines(const std::string& file, const std::vector<uint8_t>& data);

}  // namespace iclk::internal
