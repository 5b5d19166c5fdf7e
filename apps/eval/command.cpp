#include <filesystem>

#include <spdlog/spdlog.h>

#include <iclk/align/common/stopwatch.h>
#include <iclk/session/io/output.h>

#include "apps/eval/commands.h"
#include "apps/eval/export.h"
#include "apps/eval/pictures.h"
#include "apps/eval/report.h"
#include "apps/iclk/batch/loaders.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/common/progress.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/session/run_options.h"
#include "apps/json/format.h"

namespace iclk {
namespace {

struct EvalCommand {
  std::string set, out, apply = "target";
  std::vector<std::string> appearances = {"clean"}, sweep;
  std::vector<double> strengths = {0.25, 0.5, 0.75, 1};
  LoadOptions load;
  RunOptions run;
  Settings settings;
  EvalOptions eval;
  std::string export_to;
  std::vector<std::string> peer_results;
  bool json = false;
};

const char* const kEvalFooter =
    "SET is a set of `iclk render --pairs`, or any manifest of `iclk batch` in which every pair has a truth.\n"
    "\n"
    "The tables show the error after every stage: mean, median and 95th percentile over all pairs, and the share of pairs\n"
    "within 1 px and 3 px. A stage that did not run keeps the error of the stage before. A pair without a pose keeps the\n"
    "error of its start, and never counts as within 1 px.\n"
    "  claims  the method reports success\n"
    "  wrong   claims that are more than 3 px off\n"
    "  NEES    squared pose error of the claims, normalised by their own covariance; its mean is 6 if the covariance is right\n"
    "docs/results/evaluation.md has more.\n"
    "\n"
    "Appearance: clean; jitter:S, the colour jitter of torchvision; exposure:S, gamma:S, vignetting:S, flare:S,\n"
    "motion_blur:S, noise:S, jpeg:S, shadow:S; severe or severe:S, some of these eight at random strengths. S is at most 1,\n"
    "for jitter at most 2.\n"
    "\n"
    "--out writes eval.json, rows.csv, pairs.csv, changes.jsonl (the changes that were drawn) and pictures.\n"
    "\n"
    "Examples:\n"
    "  iclk eval set\n"
    "  iclk eval set --baselines --out report\n"
    "  iclk eval set --appearance clean,jitter:0.4,severe --variants 2 --solver device --out report\n"
    "  iclk eval set/pairs.jsonl --model model.safetensors --appearance jitter:0.4 --variants 1 --apply both --seed 1\n"
    "  iclk eval set --appearance severe --variants 1 --export pairs               # for another program; here iclk again\n"
    "  iclk batch pairs/pairs.jsonl --model classical --out other.jsonl\n"
    "  iclk eval set --appearance severe --variants 1 --peer-results other=other.jsonl\n"
    "  iclk eval set --sweep noise,shadow --strengths 0.5,1 --variants 1 --out report\n"
    "\n";

std::vector<AppearanceSpec> appearances_of(const EvalCommand& command) {
  std::vector<AppearanceSpec> specs;
  if (command.sweep.empty()) {
    for (const std::string& text : command.appearances) specs.push_back(parse_appearance(text));
    return specs;
  }
  specs.push_back({});
  std::vector<std::string> kinds = command.sweep;
  if (kinds == std::vector<std::string>{"all"}) kinds = appearance_kinds();
  for (const std::string& kind : kinds)
    for (const double strength : command.strengths) specs.push_back(parse_appearance(kind + formatted(":%.9g", strength)));
  return specs;
}

/// Each file whole or not at all. eval.json goes first and comes last: a folder that has one is complete.
void write_eval(const std::string& folder, const EvalReport& report, const std::string& json) {
  const std::filesystem::path root(folder);
  std::error_code ignored;
  std::filesystem::remove(root / "eval.json", ignored);
  for (const Picture& picture : make_eval_pictures(report))
    write_file((root / picture.file).string(), encode_png(picture.image));
  write_file((root / "rows.csv").string(), rows_csv(report));
  write_file((root / "pairs.csv").string(), pairs_csv(report));
  write_file((root / "changes.jsonl").string(), changes_jsonl(report));
  write_file((root / "eval.json").string(), json);
}

void run(EvalCommand& command, int& exit) {
  const SessionOptions session = command.run.session();
  EvalOptions& options = command.eval;
  options.appearances = appearances_of(command);
  options.apply = parse_apply_to(command.apply);
  if (options.batch == 0) options.batch = session.solver == Solver::cpu ? 1 : session.stages.front().model ? 2 : 8;
  options.check();
  const LoaderCache loaders(command.load);
  for (const std::string& argument : command.peer_results) options.others.emplace_back(argument);
  const Manifest manifest = read_eval_set(command.set);
  if (!command.out.empty()) make_output_folder(command.out);

  ProgressBar bar;
  const internal::Stopwatch watch;
  const EvalLoader loader{[&](const ManifestLine& line) { return loaders.load(manifest, line); },
                          [&](const PairRequest& request, const std::string& file) {
                            const PairFiles files{request.files.target, request.files.target, file, ""};
                            return loaders.loader(request)->load(files).depth_0;
                          }};
  const EvalProgress show = [&](int done, int total) { bar.show({total, 0, done, 0, watch.ms() / 1000}); };
  exit = kConverged;
  if (!command.export_to.empty()) {
    make_output_folder(command.export_to);
    export_eval(manifest, loader, options, command.export_to, show);
    bar.clear();
    print("written    " + command.export_to + "/pairs.jsonl and its images\n");
    return;
  }
  const EvalReport report = run_eval(manifest, loader, session, options, show);
  bar.clear();

  const std::string json = to_json(report).dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
  if (!command.out.empty()) write_eval(command.out, report, json);
  print(command.json ? json : to_table(report));
  if (!command.json && !command.out.empty()) print("written    eval.json, tables and pictures in " + command.out + "\n");
}

}  // namespace

void add_eval(CLI::App& app, int& exit) {
  CLI::App* command =
      app.add_subcommand("eval", "Measure errors on pairs with true poses: every stage, other methods, changed images");
  auto o = std::make_shared<EvalCommand>();
  command->add_option("SET", o->set, "Folder with pairs.jsonl, or a manifest")->required()->check(not_empty)->type_name("PATH");
  command->option_defaults()->group("Evaluation");
  auto* appearance =
      command->add_option("--appearance", o->appearances, "Changes to the images; each has a block in the report")
          ->delimiter(',')
          ->capture_default_str()
          ->type_name("KIND[:S],...");
  command
      ->add_option("--sweep", o->sweep, "Instead of --appearance: clean, then these kinds (or all), each with all --strengths")
      ->delimiter(',')
      ->excludes(appearance)
      ->type_name("KIND,...");
  command->add_option("--strengths", o->strengths, "Strengths for --sweep")->delimiter(',')->capture_default_str();
  command->add_option("--variants", o->eval.variants, "Random draws of a change per pair")->capture_default_str();
  command->add_option("--apply", o->apply, "Which image to change; both: each with its own draw")
      ->capture_default_str()
      ->check(CLI::IsMember({"target", "reference", "both"}));
  command->add_flag(
      "--baselines", o->eval.baselines,
      "Also run the classical 6DoF-ICLK of the paper, iclk's classical mode if --model is another, and KLT, SIFT and "
      "ORB with PnP, on the same features; RgbdOdometry too, if meta.target_depth names the depth of the target");
  command
      ->add_option(
          "--peer-results", o->peer_results,
          "Results of another program, as a row of every table: lines {\"id\", \"T_10\", \"claimed\"}, or a results file "
          "of `iclk batch`; may be repeated")
      ->type_name("NAME=FILE")
      ->allow_extra_args(false);
  command->add_option("--max-pairs", o->eval.max_pairs, "Use this many pairs from the start; 0: all")->capture_default_str();
  command
      ->add_option("--batch", o->eval.batch, "Pairs that are aligned together; default: 8, with a model 2, with --solver cpu 1")
      ->check(CLI::Range(1, 4096));
  o->eval.batch = 0;
  command->option_defaults()->group("Output");
  command->add_option("--out", o->out, "Folder for tables and pictures")->check(not_empty)->type_name("DIR");
  command
      ->add_option("--export", o->export_to,
                   "Do not align: write the changed pairs as a manifest and images, for other programs")
      ->check(not_empty)
      ->type_name("DIR")
      ->excludes("--out");
  command->add_flag("--json", o->json, "Print only eval.json, on standard output");
  command->add_option("--figure", o->eval.figure, "id of the pair to draw; default: the pair in the middle of the set");
  command->option_defaults()->group("Input");
  o->load.add_to(*command, false);
  command->add_option("--seed", o->eval.seed, "Seed of the changes")->capture_default_str();
  command->option_defaults()->group("Alignment");
  o->run.add_to(*command);
  o->run.add_to(o->settings);
  o->load.add_to(o->settings);
  o->settings.add_to(*command);
  command->footer(o->settings.help() + kEvalFooter + exit_codes_help("0 done"));
  command->callback([o, &exit] { run(*o, exit); });
}

}  // namespace iclk
