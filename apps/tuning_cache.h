#pragma once
#include <functional>
#include <memory>
#include <string>

#include <iclk/align/tuning.h>

namespace iclk {

/// ICLK_TUNING: `off` takes the usual choice and touches no file; `cache`, which is the default, measures once what the file
/// lacks; `force` measures everything anew.
enum class TuningMode { off, cache, force };
/// Throws Error(invalid_argument) that lists the values.
TuningMode tuning_mode(const std::string& value);

/// $XDG_CACHE_HOME/iclk, else $HOME/.cache/iclk; empty where neither is set to an absolute path.
std::string cache_folder();

/// The fastest variant of each layer of a model's encoder on this device, for images of a size and a precision: remembered in
/// `folder` (empty: nowhere) in a file a device, driver and set of shaders. A file that is damaged or of something else is
/// ignored and written anew; one that cannot be written is only said. `say`: lines for the user, when something is measured.
Tuning cached_tuning(const std::shared_ptr<const engine::Context>& context, const Model& model, int width, int height,
                     int levels, TuningMode mode, const std::string& folder, const std::function<void(const std::string&)>& say,
                     Precision precision = Precision::fp32);

}  // namespace iclk
