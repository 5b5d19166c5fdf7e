#include "python/device.h"

#include <unistd.h>

#include <cstdlib>
#include <map>
#include <utility>

#include <nanobind/stl/string.h>

#include <iclk/engine/error.h>
#include <iclk/engine/requirements.h>
#include <iclk/session/device.h>

#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

/// Guarded by the GIL. By process: what was opened before a fork can be neither used nor closed. Never destroyed, for drivers
/// may be gone by then; forget_devices() is called before.
using Key = std::pair<pid_t, std::string>;
std::map<Key, std::shared_ptr<engine::Context>>& opened() {
  static auto* const devices = new std::map<Key, std::shared_ptr<engine::Context>>;
  return *devices;
}

}  // namespace

std::shared_ptr<engine::Context> shared_device(const std::string& wish) {
  std::string name = wish;
  if (name.empty())
    if (const char* variable = std::getenv("ICLK_DEVICE")) name = variable;
  const Key key{getpid(), name};
  if (const auto found = opened().find(key); found != opened().end()) return found->second;
  std::shared_ptr<engine::Context> context;
  try {
    const Working working;
    context = open_device(name);
  } catch (const Error& e) {
    if (e.code() != ErrorCode::no_driver) throw;
    throw Error(e.code(), std::string(e.what()) + "; device=\"cpu\" needs no Vulkan");
  }
  return opened().emplace(key, std::move(context)).first->second;
}

void forget_devices() {
  std::erase_if(opened(), [](const auto& device) { return device.first.first == getpid(); });
}

nb::typed<nb::list, nb::any> devices() {
  std::vector<engine::DeviceInfo> found;
  try {
    const Working working;
    found = engine::list_devices();
  } catch (const Error& e) {
    if (e.code() != ErrorCode::no_driver) throw;
  }
  nb::typed<nb::list, nb::any> list;
  for (size_t i = 0; i < found.size(); ++i) {
    const engine::DeviceInfo& d = found[i];
    nb::dict device;
    device["index"] = i;
    device["name"] = d.name;
    device["type"] = engine::name(d.type);
    device["uuid"] = engine::uuid_text(d.uuid);
    device["vulkan"] = engine::version_text(d.api_version);
    device["driver"] = d.driver_name;
    device["memory_bytes"] = d.device_memory;
    device["subgroup_size"] = d.subgroup_size;
    device["usable"] = d.rejected.empty();
    device["rejected"] = d.rejected;
    list.append(device);
  }
  return list;
}

}  // namespace iclk::python
