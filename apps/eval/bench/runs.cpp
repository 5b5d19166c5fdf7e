#include "apps/eval/bench/runs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include <iclk/align/common/stopwatch.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>
#include <iclk/session/pose_errors.h>
#include <iclk/session/session.h>

#include "apps/iclk/common/cpu_stopwatch.h"
#include "apps/iclk/common/median.h"
#include "apps/iclk/io/images.h"
#include "apps/json/format.h"

namespace iclk {
namespace {

constexpr int kPairsTimed = 16;      // a repetition of small batches is at least so many pairs,
constexpr int kModelPairsTimed = 4;  // and with a model so many

/// What a timed call leaves behind, for the check that the work was done.
struct Outcome {
  bool converged;
  SE3 T_10;
};

/// Times `call(first pair, outcomes)` over the pairs, in turn, after one call that is not timed.
template <typename Call>
BenchRow measure(const BenchOptions& options, std::span<const PeerPair> pairs, int batch, int pairs_timed, Call&& call) {
  BenchRow row;
  row.pairs = batch;
  const int available = static_cast<int>(pairs.size()) / batch;
  const int calls = std::max(1, pairs_timed / batch);
  std::vector<Outcome> outcomes;
  call(0, outcomes);
  std::vector<double> wall, cpu, errors;
  for (int repetition = 0; repetition < options.repetitions; ++repetition) {
    errors.clear();
    row.converged = row.run = 0;
    double repetition_cpu = 0;
    for (int i = 0; i < calls; ++i) {
      const int first = i % available * batch;
      outcomes.clear();
      const internal::Stopwatch watch;
      const CpuStopwatch cpu_watch;
      call(first, outcomes);
      wall.push_back(watch.ms() / batch);
      repetition_cpu += cpu_watch.ms() / (batch * calls);
      for (int k = 0; k < batch; ++k) {
        const PeerPair& pair = pairs[static_cast<size_t>(first + k)];
        const Outcome& outcome = outcomes[static_cast<size_t>(k)];
        row.converged += outcome.converged;
        row.run += 1;
        errors.push_back(pose_error(pair.camera, pair.features, outcome.T_10, pair.T_10).e_pixel);
      }
    }
    cpu.push_back(repetition_cpu);
  }
  row.calls = static_cast<int>(wall.size());
  row.wall = spread(wall);
  row.cpu = median(cpu);
  row.error = median(errors);
  return row;
}

struct AlignerCase {
  const char* method;
  Solver solver;
  bool colour = false, refine = false, unit_weights = false, search = false, model = false, keyframe = false;
};

const std::array kCases = {
    AlignerCase{"device", Solver::device}, AlignerCase{"host", Solver::host}, AlignerCase{"cpu", Solver::cpu},
    AlignerCase{"device, colour", Solver::device, true}, AlignerCase{"device + refine", Solver::device, false, true},
    AlignerCase{"device, unit weights", Solver::device, false, false, true},
    AlignerCase{"device + search", Solver::device, false, false, false, true},
    // with a model: the paper's way, without a search; a target against a reference that is there
    AlignerCase{.method = "model, device", .solver = Solver::device, .model = true},
    AlignerCase{.method = "model, keyframe", .solver = Solver::device, .model = true, .keyframe = true},
    AlignerCase{.method = "model, host", .solver = Solver::host, .model = true},
    AlignerCase{.method = "model, cpu", .solver = Solver::cpu, .model = true},
    AlignerCase{.method = "model + search", .solver = Solver::device, .search = true, .model = true},
    AlignerCase{.method = "model + search + refine", .solver = Solver::device, .refine = true, .search = true, .model = true}};
constexpr int kOdometryThreads[] = {0, 1};

bool wanted(const BenchOptions& options, const std::string& method, bool with_model) {
  if (with_model && !options.model) return false;
  if (options.only.empty()) return with_model == (options.model != nullptr);
  return std::find(options.only.begin(), options.only.end(), method) != options.only.end();
}

/// Batch sizes of a case: colour at the largest only, refinement, search and the paper's unit weights alone and at the
/// largest; with a model the CPU, which knows no batches, alone.
std::vector<int> batches_of(const AlignerCase& c, const BenchOptions& options) {
  const int most = *std::max_element(options.pairs.begin(), options.pairs.end());
  if (c.model && c.solver == Solver::cpu) return {*std::min_element(options.pairs.begin(), options.pairs.end())};
  std::vector<int> batches;
  for (int n : options.pairs)
    if ((!c.colour && !c.refine && !c.unit_weights && !c.search) || n == most || (!c.colour && n == 1)) batches.push_back(n);
  return batches;
}

Plan plan_of(const BenchOptions& options, int batch, bool colour) {
  return {options.width, options.height, options.features, batch, batch, false, lossless_format(false, colour)};
}

/// References and targets of a batch, on pixels that nobody copied for us.
double set_references(Aligner& aligner, std::span<const PeerPair> batch, bool colour, std::vector<Pair>& work) {
  const internal::Stopwatch watch;
  work.clear();
  for (size_t i = 0; i < batch.size(); ++i) {
    const PeerPair& pair = batch[i];
    const int slot = static_cast<int>(i);
    aligner.set_reference(slot, {view(colour ? pair.image_0 : pair.grey_0), pair.camera, pair.features, {}});
    work.push_back({slot, view(colour ? pair.image_1 : pair.grey_1), {}, {}});
  }
  return watch.ms();
}

/// Grey models get grey images, as the classical mode does.
bool in_colour(const BenchOptions& options, const AlignerCase& c) {
  return c.model ? options.model->input_channels == 3 : c.colour;
}

std::unique_ptr<Aligner> make_aligner(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, int batch,
                                      const AlignerCase& c) {
  AlignerOptions settings = c.model ? options.model->options() : AlignerOptions();
  if (c.unit_weights) settings.robust = Robust::unit;
  settings.search = c.search;
  const ModelStage stage{settings, c.model ? options.model : nullptr};
  const Session session({.solver = c.solver, .stages = {stage}}, context);
  return session.make_aligner(plan_of(options, batch, in_colour(options, c)));
}

BenchRow bench_aligner(const BenchOptions& options, const std::shared_ptr<engine::Context>& context,
                       std::span<const PeerPair> pairs, int batch, const AlignerCase& c) {
  const bool colour = in_colour(options, c);
  const auto aligner = make_aligner(options, context, batch, c);
  const auto refiner = c.refine ? std::make_unique<Refiner>(*aligner) : nullptr;
  if (c.keyframe) pairs = pairs.first(static_cast<size_t>(batch));
  std::vector<Pair> work;
  const int pairs_timed = c.model ? kModelPairsTimed : kPairsTimed;
  BenchRow row = measure(options, pairs, batch, pairs_timed, [&](int first, std::vector<Outcome>& outcomes) {
    if (!c.keyframe || work.empty())
      set_references(*aligner, pairs.subspan(static_cast<size_t>(first), static_cast<size_t>(batch)), colour, work);
    if (refiner) {
      for (const RefinedAlignment& r : refiner->align(work)) outcomes.push_back({r.converged(), r.T_10});
    } else {
      for (const Alignment& a : aligner->align(work)) outcomes.push_back({a.converged(), a.T_10});
    }
  });
  row.method = c.method;
  row.format = colour ? "rgba8" : "r8";
  return row;
}

BenchRow bench_method(const BenchOptions& options, std::span<const PeerPair> pairs, PeerMethod& method) {
  BenchRow row = measure(options, pairs, 1, kPairsTimed, [&](int first, std::vector<Outcome>& outcomes) {
    const PeerAnswer answer = method.run(pairs[static_cast<size_t>(first)]);
    outcomes.push_back({answer.claimed, answer.T_10});
  });
  row.method = method.name();
  return row;
}

void add_refinement(const std::vector<RefinedAlignment>& results, std::vector<Stage>& sums) {
  for (const RefinedAlignment& r : results)
    for (const Stage& stage : r.stages) {
      if (stage.name == "iclk") continue;  // in the device's own stages
      const auto at = std::find_if(sums.begin(), sums.end(), [&](const Stage& s) { return s.name == stage.name; });
      if (at == sums.end())
        sums.push_back({stage.name, {}, 0, stage.ms});
      else
        at->ms += stage.ms;
    }
}

BenchProfile profile_device(const BenchOptions& options, const std::shared_ptr<engine::Context>& context,
                            std::span<const PeerPair> pairs, int batch) {
  const bool learned = options.model != nullptr;
  const AlignerCase c{.method = "", .solver = Solver::device, .search = true, .model = learned};
  const auto any_aligner = make_aligner(options, context, batch, c);
  auto& aligner = dynamic_cast<DeviceAligner&>(*any_aligner);
  const auto refiner = learned ? std::make_unique<Refiner>(aligner) : nullptr;
  BenchProfile profile;
  profile.pairs = batch;
  profile.model = learned;
  std::vector<Pair> work;
  const int calls = options.repetitions * std::max(1, (learned ? kModelPairsTimed : kPairsTimed) / batch);
  std::vector<double> wall, prepare;
  for (int i = -1; i < calls; ++i) {  // the first call is not counted
    if (i == 0) aligner.enable_timing(true);
    const size_t first =
        static_cast<size_t>(std::max(i, 0)) % (pairs.size() / static_cast<size_t>(batch)) * static_cast<size_t>(batch);
    const internal::Stopwatch watch;
    const auto group = pairs.subspan(first, static_cast<size_t>(batch));
    const double references = set_references(aligner, group, in_colour(options, c), work);
    std::vector<RefinedAlignment> refined;
    if (refiner)
      refined = refiner->align(work);
    else
      aligner.align(work);
    if (i < 0) continue;
    wall.push_back(watch.ms() / batch);
    prepare.push_back(references / batch);
    add_refinement(refined, profile.refinement);
  }
  profile.wall = median(wall);
  profile.set_reference = median(prepare);
  for (Stage& stage : profile.refinement) stage.ms /= static_cast<double>(calls) * batch;
  if (learned)
    profile.encoder_gmac = 1e-9 * options.model->encoder_macs(options.width, options.height, options.model->levels());
  for (engine::StageTime stage : aligner.times()) {
    stage.milliseconds /= static_cast<double>(calls) * batch;
    stage.count /= calls;
    if (stage.name == "encode") profile.encoder_gflops = 2 * 2 * profile.encoder_gmac / (1e-3 * stage.milliseconds);
    profile.stages.push_back(stage);
  }
  return profile;
}

std::string joined(const std::vector<std::string>& names) {
  std::string all;
  for (const std::string& name : names) all += (all.empty() ? "'" : ", '") + name + "'";
  return all;
}

}  // namespace

void BenchOptions::check() const {
  const auto require = [](bool good, const std::string& what) {
    if (!good) throw Error(ErrorCode::invalid_argument, what);
  };
  require(!pairs.empty(), "--pairs: at least one number is needed");
  for (int n : pairs) require(n >= 1 && n <= 1024, "--pairs " + std::to_string(n) + " must lie in 1 to 1024");
  require(repetitions >= 1 && repetitions <= 10000, "--repetitions " + std::to_string(repetitions) + " must lie in 1 to 10000");
  const std::vector<std::string> known = bench_methods();
  for (const std::string& method : only)
    require(std::find(known.begin(), known.end(), method) != known.end(),
            "--only " + printable(method) + " is unknown; known are " + joined(known));
  require(features >= 1 && features <= 10000, "--features " + std::to_string(features) + " must lie in 1 to 10000");
  require(width >= 64 && width <= 4096 && height >= 64 && height <= 4096,
          "--size " + std::to_string(width) + "x" + std::to_string(height) + " must lie in 64x64 to 4096x4096");
}

std::vector<std::string> bench_methods() {
  std::vector<std::string> names;
  for (const AlignerCase& c : kCases) names.push_back(c.method);
  for (int threads : kOdometryThreads) names.push_back(make_rgbd_odometry(threads)->name());
  return names;
}

BenchReport run_bench(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, const Progress& progress) {
  options.check();
  BenchReport report;
  report.options = options;
  report.machine = describe_machine(context.get());
  const int most = *std::max_element(options.pairs.begin(), options.pairs.end());
  const std::vector<PeerPair> pairs = make_bench_pairs({options.width, options.height, options.features}, most, progress);

  struct Step {
    std::string name;
    std::function<void()> run;
  };
  std::vector<Step> steps;
  for (const AlignerCase& c : kCases)
    for (int n : wanted(options, c.method, c.model) ? batches_of(c, options) : std::vector<int>())
      steps.push_back({formatted("%s, %d at a time", c.method, n),
                       [&, n] { report.rows.push_back(bench_aligner(options, context, pairs, n, c)); }});
  for (int threads : kOdometryThreads)
    if (const std::shared_ptr method = make_rgbd_odometry(threads); wanted(options, method->name(), false))
      steps.push_back({method->name(), [&, method] { report.rows.push_back(bench_method(options, pairs, *method)); }});
  for (int n : options.profile ? options.pairs : std::vector<int>())
    steps.push_back({formatted("profile, %d at a time", n),
                     [&, n] { report.profiles.push_back(profile_device(options, context, pairs, n)); }});
  const int total = static_cast<int>(steps.size());
  for (int i = 0; i < total; ++i) {
    progress(steps[static_cast<size_t>(i)].name, i, total);
    steps[static_cast<size_t>(i)].run();
  }
  progress("", total, total);
  return report;
}

double bench_wall(const BenchReport& report, const std::string& method, int pairs) {
  for (const BenchRow& row : report.rows)
    if (row.method == method && row.pairs == pairs) return row.wall.median;
  return std::numeric_limits<double>::quiet_NaN();
}

void save_bench_pair(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, const std::string& path) {
  const auto pairs =
      make_bench_pairs({options.width, options.height, options.features}, 1, [](const std::string&, int, int) {});
  const AlignerCase c{.method = "", .solver = Solver::device, .model = options.model != nullptr};
  const bool colour = in_colour(options, c);
  const auto aligner = make_aligner(options, context, 1, c);
  std::vector<Pair> work;
  set_references(*aligner, pairs, colour, work);
  write_pair(path, pairs.front(), colour, aligner->align(work.front()).T_10);
}

}  // namespace iclk
