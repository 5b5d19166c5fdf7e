#include <algorithm>
#include <cstdio>
#include <tuple>

#include <iclk/session/device.h>
#include <iclk/session/io/text.h>

#include "apps/eval/bench/layers.h"
#include "apps/eval/bench/runs.h"
#include "apps/eval/commands.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"

namespace iclk {
namespace {

struct BenchCommand {
  BenchOptions bench;
  SessionOptions session;
  std::string size = "640x480";
  std::string save_pair;
  bool layers = false, json = false;
};

const char* const kBenchFooter =
    "Measures the time per pair of every solver and of OpenCV's RgbdOdometry, on synthetic images, with default settings.\n"
    "A call takes references and targets in host memory and returns poses in host memory. Compilation and allocation happen\n"
    "before the first call and are not counted.\n"
    "A learned --model also gets its time by stage: for whole pairs, for targets of a prepared reference (keyframe), and with\n"
    "search and refinement.\n"
    "cpu time is the processor time of all threads of this process; other work on the machine hardly affects it.\n"
    "`iclk eval --baselines` compares errors instead.\n"
    "\n"
    "Examples:\n"
    "  iclk bench\n"
    "  iclk bench --pairs 1,64 --repetitions 20 --only device --profile\n"
    "  iclk bench --model model.safetensors --size 752x480 --pairs 1,16\n"
    "  iclk bench --model model.safetensors --size 752x480 --layers\n"
    "\n";

void run(BenchCommand& command, int& exit) {
  std::tie(command.bench.width, command.bench.height) = parse_size(command.size, "--size");
  command.session.stages = make_stages(command.session);
  if (command.session.stages.size() > 1)
    throw Error(ErrorCode::invalid_argument,
                "--model auto runs several models: name the one to measure, such as --model sd6dof");
  const std::shared_ptr<const Model> model = command.bench.model = command.session.stages.front().model;
  if (command.bench.pairs.empty()) command.bench.pairs = model ? std::vector{1, 4} : BenchOptions().pairs;
  command.bench.profile |= model != nullptr;
  command.bench.check();
  const auto device = open_device(command.session.device);
  exit = kConverged;
  if (command.layers) {
    if (!model) throw Error(ErrorCode::invalid_argument, "--layers needs --model FILE: the classical mode has no encoder");
    const LayerReport report = run_layers(device, *model, command.bench.width, command.bench.height, model->levels(),
                                          command.bench.repetitions, terminal_progress());
    print(command.json ? to_json(report).dump(2) + "\n" : to_table(report));
    return;
  }
  if (!command.save_pair.empty()) save_bench_pair(command.bench, device, command.save_pair);
  const BenchReport report = run_bench(command.bench, device, terminal_progress());
  print(command.json ? to_json(report).dump(2) + "\n" : to_table(report));
}

}  // namespace

void add_bench(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("bench", "Measure the time per pair, on synthetic images");
  auto options = std::make_shared<BenchCommand>();
  command->add_flag("--json", options->json, "Print only JSON, on standard output");
  command->add_option("--features", options->bench.features, "Features per pair")->capture_default_str();
  options->bench.pairs.clear();
  command
      ->add_option("--pairs", options->bench.pairs,
                   "Pairs per call; each number is a line of the table; default: 1,4,16,64, with a model 1,4")
      ->delimiter(',');
  command->add_option("--repetitions", options->bench.repetitions, "Repetitions of every measurement")->capture_default_str();
  command->add_option("--size", options->size, "Image size, WIDTHxHEIGHT")->capture_default_str();
  command->add_option("--only", options->bench.only, "Methods to measure, by their names in the table; default: all");
  command->add_flag("--profile", options->bench.profile,
                    "Also print the device solver's time by stage; always on with a learned model");
  command
      ->add_option("--save-pair", options->save_pair,
                   "Write the first pair and its pose as safetensors, for apps/train/bench.py --iclk")
      ->check(not_empty)
      ->type_name("FILE");
  command->add_flag("--layers", options->layers,
                    "Measure every layer of the encoder of --model, with every variant of its convolution");
  options->session.model = "classical";
  command
      ->add_option("--model", options->session.model,
                   "classical, which is compared with other methods, or the name or file of a learned model")
      ->capture_default_str()
      ->check(not_empty)
      ->type_name("FILE|classical");
  command->add_option(
      "--device", options->session.device,
      "Vulkan device: index, UUID or part of the name (see `iclk devices`); default: ICLK_DEVICE, else the best");
  command->footer(kBenchFooter + exit_codes_help("0 done"));
  command->callback([options, &exit] { run(*options, exit); });
}

}  // namespace iclk
