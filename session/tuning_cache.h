#pragma once
#include <string>

#include <iclk/align/tuning.h>

namespace iclk {

/// ICLK_TUNING: `cache`, which is the default, takes what the user's file holds; `off` ignores the file.
enum class TuningMode { off, cache };
/// Throws Error(invalid_argument) that lists the values.
TuningMode tuning_mode(const std::string& value);
TuningMode tuning_mode();  ///< of the environment

/// $XDG_CACHE_HOME/iclk, else $HOME/.cache/iclk; empty where neither is set to an absolute path.
std::string cache_folder();

/// The file of a folder in which choices for this device, driver and set of shaders are remembered.
std::string tuning_file(const engine::Context& context, const std::string& folder);

/// What that file holds, of all models and sizes. Nothing where the folder is empty (""), the file is not there,
/// damaged or of something else.
Tuning read_tuning(const engine::Context& context, const std::string& folder);

/// Writes it whole or not at all. Throws Error(io).
void write_tuning(const engine::Context& context, const std::string& folder, const Tuning& tuning);

}  // namespace iclk
