#include <memory>
#include <utility>

#include <iclk/align/model_file.h>
#include <iclk/session/io/text.h>
#include <iclk/session/models.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/json/model_info.h"

namespace iclk {
namespace {

struct InfoCommand {
  std::string model, size = "752x480";
  bool json = false;
};

}  // namespace

void add_model(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("model", "Show what is in a model file");
  command->require_subcommand(1);
  CLI::App* info = command->add_subcommand("info", "Print architecture, cost, licence and provenance of a model");
  auto options = std::make_shared<InfoCommand>();
  info->add_option("MODEL", options->model, "Model file, or the name of a model that comes with iclk (sd6dof, sd6dof-small)")
      ->required()
      ->check(not_empty);
  info->add_option("--size", options->size, "Image size for the cost, WIDTHxHEIGHT")->capture_default_str()->check(not_empty);
  info->add_flag("--json", options->json, "Print only JSON, on standard output");
  const std::string footer =
      "GMAC: 10^9 multiply-accumulates. Receptive field: side of the square of pixels that a value depends on.\n"
      "\n"
      "Examples:\n"
      "  iclk model info model.safetensors\n"
      "  iclk model info model.safetensors --size 1280x720 --json\n"
      "\n";
  info->footer(footer + exit_codes_help("0 done", false));
  command->footer("Examples:\n  iclk model info model.safetensors\n");
  info->callback([options, &exit] {
    const auto [width, height] = parse_size(options->size, "--size");
    const Model model = load_model(find_model(options->model));
    print(options->json ? model_json(model, width, height).dump(2) + "\n" : model_table(model, width, height));
    exit = kConverged;
  });
}

}  // namespace iclk
