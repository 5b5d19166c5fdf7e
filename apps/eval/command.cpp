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
    "SET is what `iclk render --pairs` wrote, or any manifest of `iclk batch` in which every pair has a truth. Tables: the "
    "error\n"
    "left after every stage, in the mean, the median and the 95th percentile over all pairs, and the share of pairs within 1 "
    "px\n"
    "and 3 px. A stage that did not run leaves the error of the stage before; a pair without a pose has the error of its "
    "start\n"
    "and is never within 1 px. Claims: the method says that it succeeded; wrong: of these, more than 3 px off. NEES: squared\n"
    "pose error of the claims by their own covariance, 6 in the mean if that is right. docs/results/evaluation.md says more.\n"
    "\n"
    "Appearance: clean; jitter:S, colour jitter as torchvision's; exposure:S, gamma:S, vignetting:S, flare:S, motion_blur:S,\n"
    "noise:S, jpeg:S, shadow:S; severe or severe:S, some of these eight at random strengths. S up to 1, of jitter up to 2.\n"
    "\n"
    "--out writes eval.json, rows.csv, pairs.csv, changes.jsonl (what was drawn) and pictures.\n"
    "\n"
    "Examples:\n"
    "  iclk eval set\n"
    "  iclk eval set --baselines --out report\n"
    "  iclk eval set --appearance clean,jitter:0.4,severe --variants 2 --solver device --out report\n"
    "  iclk eval set/pairs.jsonl --model model.safetensors --appearance jitter:0.4 --variants 1 --apply both --seed 1\n"
    "  iclk eval set --appearance severe --variants 1 --export pairs               # for another program, here iclk again\n"
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
      app.add_subcommand("eval", "Errors over a set of pairs with truth: every stage, baselines, appearance changes");
  auto o = std::make_shared<EvalCommand>();
  command->add_option("SET", o->set, "Folder with pairs.jsonl, or a manifest")->required()->check(not_empty)->type_name("PATH");
  command->option_defaults()->group("Evaluation");
  auto* appearance = command->add_option("--appearance", o->appearances, "Changes to the images, one block of the report each")
                         ->delimiter(',')
                         ->capture_default_str()
                         ->type_name("KIND[:S],...");
  command->add_option("--sweep", o->sweep, "Instead: clean, then these kinds (or all) at every one of --strengths")
      ->delimiter(',')
      ->excludes(appearance)
      ->type_name("KIND,...");
  command->add_option("--strengths", o->strengths, "Of --sweep")->delimiter(',')->capture_default_str();
  command->add_option("--variants", o->eval.variants, "Draws of a change for each pair")->capture_default_str();
  command->add_option("--apply", o->apply, "Which image is changed; both: each in its own way")
      ->capture_default_str()
      ->check(CLI::IsMember({"target", "reference", "both"}));
  command->add_flag("--baselines", o->eval.baselines,
                    "Also the paper's classical 6DoF-ICLK, with a model our classical mode, KLT, SIFT and ORB with PnP, and\n"
                    "RgbdOdometry where meta.target_depth names the depth of the target; on the same features");
  command
      ->add_option("--peer-results", o->peer_results,
                   "A method that ran elsewhere, a row of every table: {\"id\", \"T_10\", \"claimed\"} a line, or what\n"
                   "`iclk batch` writes; may be repeated")
      ->type_name("NAME=FILE")
      ->allow_extra_args(false);
  command->add_option("--max-pairs", o->eval.max_pairs, "The first so many pairs; 0: all")->capture_default_str();
  command->add_option("--batch", o->eval.batch, "Pairs on the device at a time; default 8, with a model 2, with --solver cpu 1")
      ->check(CLI::Range(1, 4096));
  o->eval.batch = 0;
  command->option_defaults()->group("Output");
  command->add_option("--out", o->out, "Folder for tables and pictures")->check(not_empty)->type_name("DIR");
  command
      ->add_option("--export", o->export_to,
                   "Align nothing: write the pairs, changed, as a manifest and images for other programs")
      ->check(not_empty)
      ->type_name("DIR")
      ->excludes("--out");
  command->add_flag("--json", o->json, "eval.json on standard output, and nothing else there");
  command->add_option("--figure", o->eval.figure, "id of the pair to draw; default: the one in the middle of the set");
  command->option_defaults()->group("Input");
  o->load.add_to(*command, false);
  command->add_option("--seed", o->eval.seed, "Of the changes")->capture_default_str();
  command->option_defaults()->group("Alignment");
  o->run.add_to(*command);
  o->run.add_to(o->settings);
  o->load.add_to(o->settings);
  o->settings.add_to(*command);
  command->footer(o->settings.help() + kEvalFooter + exit_codes_help("0 done"));
  command->callback([o, &exit] { run(*o, exit); });
}

}  // namespace iclk
