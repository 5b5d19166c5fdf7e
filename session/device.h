#pragma once
#include <memory>
#include <string>

#include <iclk/engine/context.h>

namespace iclk {

/// Opens the device that `wish` names by index, part of its name or UUID. Empty: the environment variable ICLK_DEVICE, else the
/// best device. Compiled pipelines are saved in `$XDG_CACHE_HOME/iclk`, else `$HOME/.cache/iclk`, for later runs, if the driver
/// supports it. Throws the errors of engine::create_context().
std::shared_ptr<engine::Context> open_device(std::string wish = {});

}  // namespace iclk
