#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace iclk {

/// Begins or goes on with a folder of rendered files. `file` in it says what they depend on, {kind: 1, "options": .., "about":
/// ..}, and is written first; `about` is for people and not compared. Makes `folders` in it. Throws Error(io) if it cannot be
/// written; Error(invalid_argument) if it holds something else, or files of other options (which one, then and now).
void open_set_folder(const std::string& folder, const std::string& file, const std::string& kind,
                     const nlohmann::ordered_json& options, const nlohmann::ordered_json& about,
                     const std::vector<std::string>& folders);

/// Removes what a kill left half written in folders of it, which has names of its own (write_file()).
void remove_half_written(const std::string& folder, const std::vector<std::string>& folders);

/// What the file system of the folder has left for us, bytes.
uint64_t free_bytes(const std::string& folder);

}  // namespace iclk
