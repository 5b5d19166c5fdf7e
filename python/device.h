#pragma once
#include <memory>
#include <string>

#include <nanobind/nanobind.h>

#include <iclk/engine/context.h>

namespace iclk::python {

/// The device of this name, opened once a process (open_device): contexts are thread-safe, and any number of aligners share
/// one. Precondition: the GIL is held; it is released while the device is opened.
std::shared_ptr<engine::Context> shared_device(const std::string& wish);

/// Lets the devices go that nobody uses.
void forget_devices();

/// A dict a Vulkan device; none where there is no Vulkan.
nanobind::typed<nanobind::list, nanobind::any> devices();

}  // namespace iclk::python
