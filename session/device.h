#pragma once
#include <memory>
#include <string>

#include <iclk/engine/context.h>

namespace iclk {

/// The device that `wish` names by index, part of the name or UUID; empty: ICLK_DEVICE, else the best. Pipelines that its
/// driver compiles are kept in $XDG_CACHE_HOME/iclk, else $HOME/.cache/iclk, for later runs, where the driver allows that.
/// Throws what engine::create_context() throws.
std::shared_ptr<engine::Context> open_device(std::string wish = {});

}  // namespace iclk
