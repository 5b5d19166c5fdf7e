#include <algorithm>
#include <cstdio>
#include <tuple>

#include <iclk/session/device.h>
#include <iclk/session/io/text.h>

#include "apps/bench/layers.h"
#include "apps/bench/runs.h"
#include "apps/commands/command.h"
#include "apps/commands/run_options.h"
#include "apps/peers/peers.h"

namespace iclk {
namespace {

struct BenchCommand {
  BenchOptions bench;
  PeerOptions peers;
  RunOptions run;
  std::string size = "640x480";
  std::string save_pair;
  bool with_peers = false, layers = false, json = false;
};

const char* const kBenchFooter =
    "Without --peers: ms a pair of every solver and of OpenCV's RgbdOdometry, on images made in code. A call takes references "
    "and targets\n"
    "in host memory to poses in host memory; compilation and allocation come before the first. Settings of the aligner are its "
    "own.\n"
    "With --model (else classical): the same of the learned model (the paper's way; keyframe: a target against a reference "
    "that "
    "is\n"
    "there; with search and refinement), and the time by stage.\n"
    "With --peers: how right and how fast iclk and its competitors are on real sequences. Here the settings of `iclk align` "
    "hold,\n"
    "with sd6dof, its last word, unless --model or ICLK_MODEL names another.\n"
    "cpu time is that of all threads of this process, which other work on the machine hardly disturbs.\n"
    "\n"
    "Examples:\n"
    "  iclk bench\n"
    "  iclk bench --pairs 1,64 --repetitions 20 --only device --profile\n"
    "  iclk bench --model model.safetensors --size 752x480 --pairs 1,16\n"
    "  iclk bench --model model.safetensors --size 752x480 --layers\n"
    "  iclk bench --peers --data ../shared/data --json > peers.json\n"
    "  iclk bench --peers --distortion radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633\n";

void need_one_model(const SessionOptions& session) {
  if (session.stages.size() > 1)
    throw Error(ErrorCode::invalid_argument,
                "--model auto is several models: name the one to measure (`iclk eval` and `iclk batch` take auto)");
}

void run(BenchCommand& command, int& exit) {
  if (command.run.chosen.model.empty()) {
    const std::string usual = default_model() == "auto" ? "sd6dof" : default_model();  // one model is measured
    command.run.chosen.model = command.with_peers ? usual : "classical";
  }
  if (command.with_peers) {
    const SessionOptions session = command.run.session();
    need_one_model(session);
    command.peers.iclk = session;
    command.peers.features = command.bench.features;
    command.peers.check();
    find_data(command.peers.data);
    if (session.solver != Solver::cpu) command.peers.context = open_device(session.device);
    const PeerReport report = run_peers(command.peers, terminal_progress());
    print(command.json ? to_json(report).dump(2) + "\n" : to_table(report));
  } else {
    std::tie(command.bench.width, command.bench.height) = parse_size(command.size, "--size");
    const SessionOptions session = command.run.session();
    need_one_model(session);
    const std::shared_ptr<const Model> model = command.bench.model = session.stages.front().model;
    if (command.bench.pairs.empty()) command.bench.pairs = model ? std::vector{1, 4} : BenchOptions().pairs;
    command.bench.profile |= model != nullptr;
    command.bench.check();
    const auto device = open_device(session.device);
    if (command.layers) {
      if (!model) throw Error(ErrorCode::invalid_argument, "--layers needs --model FILE: the classical mode has no encoder");
      const LayerReport report = run_layers(device, *model, command.bench.width, command.bench.height, model->levels(),
                                            command.bench.repetitions, terminal_progress());
      print(command.json ? to_json(report).dump(2) + "\n" : to_table(report));
      exit = kConverged;
      return;
    }
    if (!command.save_pair.empty()) save_bench_pair(command.bench, device, command.save_pair);
    const BenchReport report = run_bench(command.bench, device, terminal_progress());
    print(command.json ? to_json(report).dump(2) + "\n" : to_table(report));
  }
  exit = kConverged;
}

}  // namespace

void add_bench(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand(
      "bench", "Measure: ms a pair on images made in code, or (--peers) errors and times of the competitors");
  auto options = std::make_shared<BenchCommand>();
  command->add_flag("--json", options->json, "JSON on standard output, and nothing else there");
  command->add_option("--features", options->bench.features, "Features a pair")->capture_default_str();
  options->bench.pairs.clear();
  command->add_option("--pairs", options->bench.pairs, "Pairs in one call: one line each; default 1,4,16,64, with a model 1,4")
      ->delimiter(',');
  command->add_option("--repetitions", options->bench.repetitions, "Repetitions of every figure")->capture_default_str();
  command->add_option("--size", options->size, "Images, WIDTHxHEIGHT")->capture_default_str();
  command->add_option("--only", options->bench.only, "Methods to measure, by the names in the table; default all");
  command->add_flag("--profile", options->bench.profile, "Also the device solver's time by stage; always with a model");
  command
      ->add_option("--save-pair", options->save_pair,
                   "Write the first pair and the pose found for it as safetensors: what apps/train/bench.py --iclk compares")
      ->check(not_empty)
      ->type_name("FILE");
  auto* layers = command->add_flag("--layers", options->layers,
                                   "Every layer of --model's encoder in every variant of its convolution: what "
                                   "`iclk devices --tune` chooses from");
  auto* peers = command->add_flag("--peers", options->with_peers,
                                  "Compare with RgbdOdometry, KLT and SIFT on tum_fr1_360_5 and hololens_80");
  layers->excludes(peers);
  command->add_option("--data", options->peers.data, "Folder that holds them; default ICLK_DATA, else ../shared/data")
      ->needs(peers);
  command
      ->add_option("--distortion", options->peers.distortion, "Lens of tum_fr1_360_5: adds a run of it with undistorted images")
      ->needs(peers);
  command->add_option("--strides", options->peers.strides, "Of hololens_80: frame i against frame i + stride")
      ->delimiter(',')
      ->capture_default_str()
      ->needs(peers);
  command->add_option("--max-pairs", options->peers.max_pairs, "Of a row, spread over the sequence; 0: all")
      ->capture_default_str()
      ->needs(peers);
  const std::vector<CLI::Option*> own = command->get_options();
  options->run.chosen.model.clear();  // known when it is known what is measured
  options->run.add_to(*command);
  for (const char* name : {"--dense", "--no-refine"})
    command->remove_option(command->get_option(name));  // both ways are measured; depth is sparse
  for (CLI::Option* option : command->get_options())    // what is left sets up iclk among its peers
    if (option->get_name() != "--device" && option->get_name() != "--model" &&
        std::find(own.begin(), own.end(), option) == own.end())
      option->needs(peers);
  command->footer(std::string(kBenchFooter));
  command->callback([options, &exit] { run(*options, exit); });
}

}  // namespace iclk
