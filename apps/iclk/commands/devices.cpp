#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <iclk/align/model_file.h>
#include <iclk/engine/context.h>
#include <iclk/session/device.h>
#include <iclk/session/io/text.h>
#include <iclk/session/models.h>
#include <iclk/session/tuning_cache.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/commands/device_tuning.h"
#include "apps/iclk/common/not_empty.h"
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

struct DevicesCommand {
  bool json = false, tune = false;
  std::string device;
  std::vector<std::string> models = {"sd6dof-small", "sd6dof"}, sizes = {"640x480"};
};

void list(const DevicesCommand& command) {
  const std::vector<engine::DeviceInfo> devices = engine::list_devices();
  print(command.json ? to_json(devices) : to_table(devices));
  if (devices.empty()) throw Error(ErrorCode::no_device, "the Vulkan drivers of this machine find no device");
}

void tune(const DevicesCommand& command) {
  TuningWish wish;
  for (const std::string& model : command.models) wish.models.push_back(std::make_shared<Model>(load_model(find_model(model))));
  for (const std::string& size : command.sizes) wish.sizes.push_back(parse_size(size, "--size"));
  const TuningMode mode = tuning_mode();
  const auto context = open_device(command.device);
  spdlog::info("measuring every kernel for each layer on {}; it takes some seconds on a CPU, best while nothing else runs",
               context->info().name);
  const TuningReport report = tune_device(context, wish, cache_folder(), terminal_progress());
  print(command.json ? to_json(report).dump(2) + "\n" : to_table(report));
  if (mode == TuningMode::off) spdlog::warn("ICLK_TUNING is off: commands do not read this file");
}

}  // namespace

void add_devices(CLI::App& app, int& exit) {
  CLI::App* command =
      app.add_subcommand("devices", "List the Vulkan devices of this machine, or find the fastest kernels for one (--tune)");
  auto options = std::make_shared<DevicesCommand>();
  command->add_flag("--json", options->json, "JSON on standard output, and nothing else there");
  auto* tuning = command->add_flag(
      "--tune", options->tune, "Measure which kernels compute a model's layers the fastest, and remember it for all commands");
  command->option_defaults()->group("With --tune");
  command->add_option("--device", options->device, "Vulkan device, as for `iclk align`; default ICLK_DEVICE, else the best")
      ->needs(tuning);
  command->add_option("--model", options->models, "Learned models whose encoders are measured, files or names; several times")
      ->capture_default_str()
      ->check(not_empty)
      ->allow_extra_args(false)
      ->type_name("FILE")
      ->needs(tuning);
  command->add_option("--size", options->sizes, "Images, WIDTHxHEIGHT; several times")
      ->capture_default_str()
      ->check(not_empty)
      ->allow_extra_args(false)
      ->type_name("WxH")
      ->needs(tuning);
  command->footer(
      "The index, a part of the name or the UUID is what --device and ICLK_DEVICE take.\n"
      "Without them the first usable one of discrete, integrated, virtual, CPU is chosen.\n"
      "\n"
      "No other command chooses by measuring, so that two runs give the same bits. What --tune has not measured goes by\n"
      "a rule on a CPU device, and takes the plainest kernel on a GPU. A choice holds for images of that very size.\n"
      "The file lies in $XDG_CACHE_HOME/iclk, else ~/.cache/iclk, and is of one device, driver and version of the kernels;\n"
      "ICLK_TUNING=off ignores it.\n"
      "\n"
      "Examples:\n"
      "  iclk devices\n"
      "  iclk devices --json\n"
      "  iclk demo --device 0\n"
      "  iclk devices --tune --model sd6dof-small --size 320x240\n"
      "  iclk devices --tune --device 0 --model model.safetensors --size 160x120 --size 96x72\n"
      "\n" +
      exit_codes_help("0 done"));
  command->callback([options, &exit] {
    options->tune ? tune(*options) : list(*options);
    exit = kConverged;
  });
}

}  // namespace iclk
