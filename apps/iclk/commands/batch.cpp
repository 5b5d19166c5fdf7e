#include <unistd.h>

#include <atomic>
#include <csignal>
#include <filesystem>
#include <thread>

#include <spdlog/spdlog.h>
#include <opencv2/core/utility.hpp>

#include <iclk/align/model_file.h>
#include <iclk/session/device.h>
#include <iclk/session/pose_errors.h>

#include "apps/iclk/batch/loaders.h"
#include "apps/iclk/batch/run.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/progress.h"
#include "apps/iclk/common/version.h"
#include "apps/iclk/session/report.h"
#include "apps/iclk/session/run_options.h"
#include "apps/json/format.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

struct BatchOptions {
  std::string manifest, out, shard = "0/1";
  LoadOptions load;
  RunOptions run;
  Settings settings;
  int batch = 0, threads = 0;
  size_t memory = 1024;
  std::string retry = "none";
  bool with_features = false;
};

const char* const kBatchFooter =
    "MANIFEST.jsonl has one JSON object per line:\n"
    "  {\"id\": \"a\", \"reference\": \"rgb/a.png\", \"target\": \"rgb/b.png\", \"depth\": \"depth/a.png\"}\n"
    "  reference, target              image files; required\n"
    "  depth, features                depth image and/or feature file of the reference; at least one is required\n"
    "  reference_mask, target_mask    images that are 0 where the reference or the target is to be ignored\n"
    "  id                             text or whole number, unique in the file; default: the line number\n"
    "  depth_scale, camera, distortion  for this pair, instead of the options\n"
    "  initial_pose, truth            T_10: 4x4 nested lists, a TUM line 'tx ty tz qx qy qz qw' or a file with one\n"
    "  meta                           anything; copied to the result\n"
    "Relative paths start at the manifest's folder. Blank lines are skipped; any other key is an error.\n"
    "\n"
    "RESULTS.jsonl starts with a header line. One line per pair follows, in the order in which the pairs finish: id, line,\n"
    "key (hash of the manifest's line), status, inputs (the files read), errors (of T_10, if there is a truth), reason, and\n"
    "the JSON of `iclk align` without features (docs/schema/result-1.json). Times are those of the batch, shared evenly.\n"
    "A pair that cannot be read or is described wrongly has status \"error\" and a reason; the other pairs go on.\n"
    "\n"
    "To continue after Ctrl-C, a kill or a full disk, run the same command again: it skips pairs that have a result and\n"
    "repeats a half-written last line. The manifest may have new lines. iclk refuses to continue if an old result would be\n"
    "different today: another manifest, a changed line, a file of another size or time, another camera, option, model or\n"
    "iclk version. --retry changed runs just the pairs that this affects.\n"
    "Poses do not depend on --batch, --threads, --memory or --shard.\n"
    "\n"
    "Examples:\n"
    "  iclk batch pairs.jsonl --camera camera.txt --out results.jsonl\n"
    "  iclk batch pairs.jsonl --camera camera.txt --out results.jsonl --retry           # after repairing files\n"
    "  iclk batch pairs.jsonl --camera camera.txt --out results.jsonl --retry changed   # after a new calibration\n"
    "  iclk batch pairs.jsonl --camera camera.txt --out results.0.jsonl --shard 0/4     # one of four machines\n"
    "  iclk batch pairs.jsonl --camera 517.3,516.5,318.6,255.3 --depth-scale 5000 --batch 64 --out all.jsonl\n"
    "\n"
    "Exit codes: 0 every line has a result without error; 14 the same, but no pair converged; 20 every line has a result,\n"
    "some with status \"error\";\n"
    "130 stopped by Ctrl-C, 143 by SIGTERM, after the pairs on the device were written (a second signal stops at once);\n"
    "2 wrong usage, 3 bad manifest, options or results of another manifest, 4 a file cannot be read or written (disk full),\n"
    "5 no Vulkan driver or no such device, 6 the device failed: the remaining pairs are not marked, and the same command\n"
    "continues; 1 a defect of iclk.";

// What a signal handler can reach.
volatile std::sig_atomic_t g_signal = 0;
static_assert(std::atomic<std::sig_atomic_t>::is_always_lock_free);

extern "C" void on_signal(int signal) {
  if (g_signal != 0) ::_exit(kStoppedBy + signal);
  g_signal = signal;
  const char text[] = "\niclk: stopping when the pairs on the device are done; a second signal stops at once\n";
  [[maybe_unused]] const ssize_t written = ::write(STDERR_FILENO, text, sizeof text - 1);
}

void catch_signals() {
  struct sigaction action = {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_RESTART;
  for (const int signal : {SIGINT, SIGTERM}) {
    struct sigaction before = {};
    ::sigaction(signal, nullptr, &before);
    if (before.sa_handler != SIG_IGN) ::sigaction(signal, &action, nullptr);  // `nohup`, background jobs of a script
  }
  std::signal(SIGXFSZ, SIG_IGN);  // a file size limit is a full disk: an error, not a death
}

/// The device, and a second plan of one pair for images of which a whole batch does not fit.
class PairAligner {
 public:
  PairAligner(const SessionOptions& options, bool with_features)
      : options_(options), session_(options), with_features_(with_features) {}

  const Session& session() const { return session_; }

  std::vector<Json> operator()(std::span<const PairInput> pairs) {
    try {
      return run(session_, pairs);
    } catch (const Error& e) {
      if (e.code() != ErrorCode::unsupported || pairs.size() > 1 || options_.batch == 1) throw;
    }
    if (!single_) {
      options_.batch = 1;
      single_.emplace(options_);
    }
    return run(*single_, pairs);
  }

 private:
  std::vector<Json> run(Session& session, std::span<const PairInput> pairs) {
    const std::vector<RefinedAlignment> results = run_pairs(session, pairs);
    std::vector<Json> bodies;
    for (size_t i = 0; i < pairs.size(); ++i) {
      const PairInput& pair = pairs[i];
      Json body = to_json(pair, results[i], session);
      if (!with_features_) body.erase("features");
      share_times(body["timing_ms"], pairs.size());
      if (pair.truth) {
        const PoseError e = pose_error(pair.camera, pair.features, results[i].T_10, *pair.truth);
        const auto number = [](double x) { return std::isfinite(x) ? Json(x) : Json(nullptr); };
        body["errors"] = {{"e_pixel", number(e.e_pixel)}, {"e_transl", number(e.e_transl)}, {"e_rot", number(e.e_rot)}};
      }
      bodies.push_back(std::move(body));
    }
    return bodies;
  }

  /// The session's times are those of the whole batch; loading is the pair's own.
  static void share_times(Json& times, size_t pairs) {
    double total = times["load"].get<double>() + times["detect"].get<double>();
    for (const char* name : {"setup", "prepare", "align"}) {
      times[name] = times[name].get<double>() / static_cast<double>(pairs);
      total += times[name].get<double>();
    }
    times["total"] = total;
  }

  SessionOptions options_;
  Session session_;
  std::optional<Session> single_;
  bool with_features_;
};

ResultsJournal::Retry parse_retry(const std::string& text) {
  return text == "changed" ? ResultsJournal::Retry::changed
         : text == "none"  ? ResultsJournal::Retry::none
                           : ResultsJournal::Retry::failed;
}

/// What the results depend on, as the command line or the defaults say it; a model by what is in it.
Json effective_options(const CLI::App& command, const Settings& settings, const SessionOptions& session) {
  const std::vector<std::string> free = {"--help",  "MANIFEST", "--out",           "--batch",  "--threads", "--memory",
                                         "--shard", "--retry",  "--with-features", "--device", "--set"};
  Json json = Json::object();
  for (const CLI::Option* option : command.get_options()) {
    const std::string name = option->get_name();
    if (std::find(free.begin(), free.end(), name) != free.end()) continue;
    std::string value = option->get_default_str();
    if (option->count() > 0) {
      value.clear();
      for (const std::string& word : option->results()) value += (value.empty() ? "" : " ") + word;
    }
    json[name] = value;
  }
  for (const auto& [name, value] : settings.values())
    if (name != "max-pixels") json["--set " + name] = value;
  std::string hashes;
  const auto add_hash = [&](const Model* model) {
    if (model == nullptr) return;
    const std::vector<uint8_t> bytes = model_bytes(*model);
    hashes += " " + hash_of({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  };
  for (const ModelStage& stage : session.stages) add_hash(stage.model.get());
  json["--model"] = model_name(session.stages) + hashes;
  return json;
}

void run_batch_command(const BatchOptions& options, const CLI::App& command, int& exit) {
  SessionOptions session_options = options.run.session();
  const LoaderCache loaders(options.load);
  const Shard shard = parse_shard(options.shard);
  const Manifest manifest = read_manifest(options.manifest);

  Tally tally;
  const auto inputs = [&](const ManifestLine& line) { return loaders.inputs(manifest, line); };
  ResultsJournal journal(
      options.out, manifest,
      {effective_options(command, options.settings, session_options), version(), parse_retry(options.retry), inputs},
      [&](const Json& head) { tally.add(head); });
  const int before = tally.total();
  if (journal.dropped() > 0)
    spdlog::info("--retry {}: {} of {} results are computed again", options.retry, journal.dropped(),
                 journal.dropped() + before);
  BatchWork work;
  int in_shard = 0;
  for (size_t i = shard.k; i < manifest.lines.size(); i += static_cast<size_t>(shard.n)) {
    ++in_shard;
    if (!journal.has(manifest.lines[i].id)) work.lines.push_back(&manifest.lines[i]);
  }
  const int skipped = in_shard - static_cast<int>(work.lines.size());
  if (skipped > 0) spdlog::info("{} of {} pairs have a result in {}: continuing", skipped, in_shard, options.out);

  BatchOutcome outcome;
  if (!work.lines.empty()) {
    const int wanted = options.batch > 0 ? options.batch : session_options.solver == Solver::cpu ? 1 : 16;
    work.batch = session_options.batch = std::min(wanted, static_cast<int>(work.lines.size()));
    const int cores = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u, 16u));
    work.limits.threads = options.threads > 0 ? options.threads : cores;
    work.limits.pairs = work.batch + std::max(work.batch, work.limits.threads);
    work.limits.bytes = options.memory << 20;
    cv::setNumThreads(1);  // the pool has a thread a core already
    catch_signals();
    PairAligner aligner(session_options, options.with_features);
    report_device(aligner.session());
    ProgressBar bar;
    work.measure = [&](const ManifestLine& line) { return loaders.memory(manifest, line, work.limits.bytes); };
    work.decode = [&](const ManifestLine& line) { return loaders.load(manifest, line); };
    work.inputs = inputs;
    work.align = [&](std::span<const PairInput> pairs) { return aligner(pairs); };
    work.stop = [] { return g_signal != 0; };
    int warnings = 0;
    work.failed = [&](const ManifestLine&, const std::string& reason) {
      if (++warnings > 5) return;
      bar.clear();
      spdlog::warn("{}{}", reason, warnings == 5 ? " (further errors are only in the results)" : "");
    };
    outcome = run_batch(work, journal, tally, [&](const BatchOutcome& o) {
      bar.show({in_shard, skipped, o.done, o.failed, o.seconds});
    });
    bar.clear();
  }

  const int remaining = static_cast<int>(work.lines.size()) - outcome.done;
  std::string summary = tally.text();
  summary += formatted("%d pair%s in %s", outcome.done, outcome.done == 1 ? "" : "s", duration_text(outcome.seconds).c_str());
  if (outcome.done > 0) summary += formatted(" (%.2f pairs/s)", outcome.done / std::max(outcome.seconds, 1e-9));
  if (before > 0) summary += ", " + std::to_string(before) + " before";
  summary += "; results in " + options.out + "\n";
  if (journal.regular())
    print(summary);
  else
    spdlog::info("\n{}", summary);

  if (remaining > 0) spdlog::warn("{} of {} pairs remain: run the same command again to continue", remaining, in_shard);
  if (outcome.lost)
    throw Error(outcome.lost->code(),
                std::string(outcome.lost->what()) +
                    (outcome.lost->code() == ErrorCode::out_of_memory ? "; a smaller --batch needs less memory" : ""));
  const int errors = tally.count("error");
  if (errors > 0 && remaining == 0)
    spdlog::warn("{} status \"error\": see \"reason\" in the results; --retry runs {} again",
                 errors == 1 ? "1 pair has" : std::to_string(errors) + " pairs have", errors == 1 ? "it" : "them");
  const bool none = tally.total() > 0 && tally.count("converged") == 0;
  exit = outcome.stopped ? kStoppedBy + static_cast<int>(g_signal)
         : errors > 0    ? kSomePairsFailed
         : none          ? kDiverged
                         : kConverged;
}

}  // namespace

void add_batch(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("batch", "Align the pairs that a manifest lists; continues a run that was stopped");
  auto options = std::make_shared<BatchOptions>();
  command->add_option("MANIFEST", options->manifest, "Pairs as JSON lines, one per line; see below")
      ->required()
      ->type_name("FILE");
  command->add_option("--out", options->out, "Results as JSON lines; an existing file is continued")
      ->required()
      ->type_name("FILE");
  command
      ->add_option("--batch", options->batch,
                   "Pairs of one image size that are aligned together; default: 16, with --solver cpu 1")
      ->check(CLI::Range(1, 4096));
  command->add_option("--threads", options->threads, "Threads that read images; default: one per core, at most 16")
      ->check(CLI::Range(1, 256));
  command
      ->add_option(
          "--memory", options->memory,
          "Most MiB of decoded pixels in memory, of all pairs together; a single pair that needs more is an error. At most "
          "batch + max(batch, threads) pairs are in memory")
      ->capture_default_str()
      ->check(CLI::Range(1, 1 << 24));
  command
      ->add_option("--shard", options->shard,
                   "k/n: only every n-th line, starting with the k-th (from 0, k < n); each shard needs its own --out")
      ->capture_default_str()
      ->check([](const std::string& text) {
        try {
          parse_shard(text);
          return std::string();
        } catch (const Error& e) {
          return std::string(e.what());
        }
      });
  command
      ->add_option(
          "--retry", options->retry,
          "Run pairs again. failed (also without a word): those with status error; changed: those whose files, camera, "
          "options, model or iclk version have changed")
      ->expected(0, 1)
      ->default_str("failed")
      ->check(CLI::IsMember({"failed", "changed"}))
      ->type_name("[failed|changed]");
  command->add_flag("--with-features", options->with_features, "Keep the features in the results, about 100 bytes each");
  options->load.add_to(*command, false);
  options->run.add_to(*command);
  options->run.add_to(options->settings);
  options->load.add_to(options->settings);
  options->settings.add_to(*command);
  command->footer(options->settings.help() + kBatchFooter);
  command->callback([options, command, &exit] { run_batch_command(*options, *command, exit); });
}

}  // namespace iclk
