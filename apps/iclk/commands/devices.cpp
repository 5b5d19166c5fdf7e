#include <nlohmann/json.hpp>

#include <iclk/engine/context.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/session/run_pairs.h"

namespace iclk {
namespace {

std::string to_json(const std::vector<engine::DeviceInfo>& devices) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (size_t i = 0; i < devices.size(); ++i) {
    const engine::DeviceInfo& d = devices[i];
    list.push_back({{"index", i},
                    {"name", d.name},
                    {"type", name(d.type)},
                    {"uuid", engine::uuid_text(d.uuid)},
                    {"vulkan", engine::version_text(d.api_version)},
                    {"driver", d.driver_name},
                    {"memory_bytes", d.device_memory},
                    {"subgroup_size", d.subgroup_size},
                    {"usable", d.rejected.empty()},
                    {"rejected", d.rejected}});
  }
  return list.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

std::string to_table(const std::vector<engine::DeviceInfo>& devices) {
  std::string out;
  for (size_t i = 0; i < devices.size(); ++i) {
    const engine::DeviceInfo& d = devices[i];
    out += std::to_string(i) + "  " + d.name + "\n   " + name(d.type) + ", Vulkan " + engine::version_text(d.api_version) +
           (d.driver_name.empty() ? "" : ", " + d.driver_name) + ", " + std::to_string(d.device_memory >> 20) + " MiB\n   " +
           engine::uuid_text(d.uuid) + "\n";
    if (!d.rejected.empty()) out += "   not usable: " + d.rejected + "\n";
  }
  return out;
}

void list(bool json) {
  const std::vector<engine::DeviceInfo> devices = engine::list_devices();
  print(json ? to_json(devices) : to_table(devices));
  if (devices.empty())
    throw Error(ErrorCode::no_device,
                "the Vulkan drivers of this machine find no device; --solver cpu and --device cpu work without one");
}

}  // namespace

void add_devices(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("devices", "List the Vulkan devices of this machine");
  auto json = std::make_shared<bool>(false);
  command->add_flag("--json", *json, "Print only JSON, on standard output");
  command->footer(
      "--device and ICLK_DEVICE take the index, the UUID or a part of the name.\n"
      "Without them iclk takes the first usable device: discrete before integrated, virtual and CPU.\n"
      "\n"
      "Examples:\n"
      "  iclk devices\n"
      "  iclk devices --json\n"
      "  iclk demo --device 0\n"
      "\n" +
      exit_codes_help("0 done"));
  command->callback([json, &exit] {
    list(*json);
    exit = kConverged;
  });
}

}  // namespace iclk
