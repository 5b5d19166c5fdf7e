#include "apps/bench_runs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include <opencv2/imgproc.hpp>

#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>

#include "apps/detect.h"
#include "apps/io/images.h"
#include "apps/io/text.h"
#include "apps/metrics.h"
#include "apps/scene.h"

namespace iclk {
namespace {

constexpr int kVariants = 8;     // pairs from one rendering
constexpr int kPairsTimed = 16;  // a repetition of small batches is at least so many pairs

/// Motion k of a low-discrepancy series around that of `iclk demo`.
SE3 motion(int k) {
  Vector6d xi;
  const auto wave = [&](double ratio) { return 2 * std::fmod(0.5 + ratio * (k + 1), 1.0) - 1; };
  xi << 0.05 * wave(0.6180), 0.05 * wave(0.7549), 0.04 * wave(0.5698), 0.03 * wave(0.8192), 0.03 * wave(0.6711),
      0.04 * wave(0.5497);
  return SE3::exp(xi);
}

/// The same scene in a mirror: x -> -x, y -> -y.
void mirror(PeerPair& pair, bool x, bool y) {
  if (!x && !y) return;
  for (cv::Mat* image : {&pair.image_0, &pair.image_1, &pair.depth_0, &pair.depth_1}) {
    cv::Mat flipped;
    cv::flip(*image, flipped, x && y ? -1 : x ? 1 : 0);
    *image = flipped;
  }
  const Eigen::Vector3d s(x ? -1 : 1, y ? -1 : 1, 1);
  pair.T_10 = {s.asDiagonal() * pair.T_10.R * s.asDiagonal(), s.asDiagonal() * pair.T_10.t};
  if (x) pair.camera.cx = pair.camera.width - 1 - pair.camera.cx;
  if (y) pair.camera.cy = pair.camera.height - 1 - pair.camera.cy;
}

PeerPair variant(const ScenePair& scene, int index, int features) {
  const bool backwards = index & 4;
  PeerPair pair;
  pair.image_0 = (backwards ? scene.image_1 : scene.image_0).clone();
  pair.image_1 = (backwards ? scene.image_0 : scene.image_1).clone();
  pair.depth_0 = (backwards ? scene.depth_1 : scene.depth_0).clone();
  pair.depth_1 = (backwards ? scene.depth_0 : scene.depth_1).clone();
  pair.T_10 = backwards ? scene.T_10.inverse() : scene.T_10;
  pair.camera = scene.camera;
  mirror(pair, index & 1, index & 2);
  cv::cvtColor(pair.image_0, pair.grey_0, cv::COLOR_BGR2GRAY);
  cv::cvtColor(pair.image_1, pair.grey_1, cv::COLOR_BGR2GRAY);
  DetectorOptions detector;
  detector.count = features;
  pair.features = detect_features(pair.grey_0, pair.depth_0, {}, detector);
  return pair;
}

/// What a timed call leaves behind, for the check that the work was done.
struct Outcome {
  bool converged;
  SE3 T_10;
};

/// Times `call(first pair, outcomes)` over the pairs, in turn, after one call that is not timed.
template <typename Call>
BenchRow measure(const BenchOptions& options, std::span<const PeerPair> pairs, int batch, Call&& call) {
  BenchRow row;
  row.pairs = batch;
  const int available = static_cast<int>(pairs.size()) / batch;
  const int calls = std::max(1, kPairsTimed / batch);
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
      const Stopwatch watch;
      call(first, outcomes);
      wall.push_back(watch.wall_ms() / batch);
      repetition_cpu += watch.cpu_ms() / (batch * calls);
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
  bool colour = false, refine = false, unit_weights = false, search = false;
};

const std::array kCases = {AlignerCase{"device", Solver::device},
                           AlignerCase{"host", Solver::host},
                           AlignerCase{"cpu", Solver::cpu},
                           AlignerCase{"device, colour", Solver::device, true},
                           AlignerCase{"device + refine", Solver::device, false, true},
                           AlignerCase{"device, unit weights", Solver::device, false, false, true},
                           AlignerCase{"device + search", Solver::device, false, false, false, true}};
constexpr int kOdometryThreads[] = {0, 1};

bool wanted(const BenchOptions& options, const std::string& method) {
  return options.only.empty() || std::find(options.only.begin(), options.only.end(), method) != options.only.end();
}

/// Batch sizes of a case: colour at the largest only, refinement, search and the paper's unit weights alone and at the
/// largest.
std::vector<int> batches_of(const AlignerCase& c, const BenchOptions& options) {
  const int most = *std::max_element(options.pairs.begin(), options.pairs.end());
  std::vector<int> batches;
  for (int n : options.pairs)
    if ((!c.colour && !c.refine && !c.unit_weights && !c.search) || n == most || (!c.colour && n == 1)) batches.push_back(n);
  return batches;
}

Plan plan_of(const BenchOptions& options, int batch, bool colour) {
  return {options.width, options.height, options.features, batch, batch, false, colour ? PixelFormat::rgba8 : PixelFormat::r8};
}

/// References and targets of a batch, on pixels that nobody copied for us.
double set_references(Aligner& aligner, std::span<const PeerPair> batch, bool colour, std::vector<Pair>& work) {
  const Stopwatch watch;
  work.clear();
  for (size_t i = 0; i < batch.size(); ++i) {
    const PeerPair& pair = batch[i];
    const int slot = static_cast<int>(i);
    aligner.set_reference(slot, {view(colour ? pair.image_0 : pair.grey_0), pair.camera, pair.features, {}});
    work.push_back({slot, view(colour ? pair.image_1 : pair.grey_1), {}, {}});
  }
  return watch.wall_ms();
}

BenchRow bench_aligner(const BenchOptions& options, const std::shared_ptr<engine::Context>& context,
                       std::span<const PeerPair> pairs, int batch, const AlignerCase& c) {
  AlignerOptions settings;
  if (c.unit_weights) settings.robust = Robust::unit;
  settings.search.enabled = c.search;
  const auto aligner = make_any_aligner(c.solver, context, plan_of(options, batch, c.colour), settings);
  const auto refiner = c.refine ? std::make_unique<Refiner>(*aligner) : nullptr;
  std::vector<Pair> work;
  BenchRow row = measure(options, pairs, batch, [&](int first, std::vector<Outcome>& outcomes) {
    set_references(*aligner, pairs.subspan(static_cast<size_t>(first), static_cast<size_t>(batch)), c.colour, work);
    if (refiner) {
      for (const RefinedAlignment& r : refiner->align(work)) outcomes.push_back({r.converged(), r.T_10});
    } else {
      for (const Alignment& a : aligner->align(work)) outcomes.push_back({a.converged(), a.T_10});
    }
  });
  row.method = c.method;
  row.format = c.colour ? "rgba8" : "r8";
  return row;
}

BenchRow bench_method(const BenchOptions& options, std::span<const PeerPair> pairs, PeerMethod& method) {
  BenchRow row = measure(options, pairs, 1, [&](int first, std::vector<Outcome>& outcomes) {
    const PeerAnswer answer = method.run(pairs[static_cast<size_t>(first)]);
    outcomes.push_back({answer.claimed, answer.T_10});
  });
  row.method = method.name();
  return row;
}

BenchProfile profile_device(const BenchOptions& options, const std::shared_ptr<engine::Context>& context,
                            std::span<const PeerPair> pairs, int batch) {
  const auto aligner = make_device_aligner(context, plan_of(options, batch, false), {}, Solver::device);
  BenchProfile profile;
  profile.pairs = batch;
  std::vector<Pair> work;
  const int calls = options.repetitions * std::max(1, kPairsTimed / batch);
  std::vector<double> wall, prepare;
  for (int i = -1; i < calls; ++i) {  // the first call is not counted
    if (i == 0) aligner->enable_timing(true);
    const size_t first =
        static_cast<size_t>(std::max(i, 0)) % (pairs.size() / static_cast<size_t>(batch)) * static_cast<size_t>(batch);
    const Stopwatch watch;
    const double references = set_references(*aligner, pairs.subspan(first, static_cast<size_t>(batch)), false, work);
    aligner->align(work);
    if (i < 0) continue;
    wall.push_back(watch.wall_ms() / batch);
    prepare.push_back(references / batch);
  }
  profile.wall = median(wall);
  profile.set_reference = median(prepare);
  for (engine::StageTime stage : aligner->times()) {
    stage.milliseconds /= static_cast<double>(calls) * batch;
    stage.count /= calls;
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
            "--only " + printable(method) + " is not known: " + joined(known));
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

std::vector<PeerPair> make_bench_pairs(const BenchOptions& options, int count, const Progress& progress) {
  std::vector<PeerPair> pairs;
  for (int k = 0; static_cast<int>(pairs.size()) < count; ++k) {
    progress("drawing images", static_cast<int>(pairs.size()), count + 1);
    SceneOptions scene_options;
    scene_options.width = options.width;
    scene_options.height = options.height;
    scene_options.seed = static_cast<uint64_t>(k) + 1;
    const ScenePair scene = make_scene_pair(motion(k), scene_options);
    for (int v = 0; v < kVariants && static_cast<int>(pairs.size()) < count; ++v)
      pairs.push_back(variant(scene, v, options.features));
  }
  progress("", count + 1, count + 1);
  return pairs;
}

BenchReport run_bench(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, const Progress& progress) {
  options.check();
  BenchReport report;
  report.options = options;
  report.machine = describe_machine(context.get());
  const int most = *std::max_element(options.pairs.begin(), options.pairs.end());
  const std::vector<PeerPair> pairs = make_bench_pairs(options, std::max(most, kVariants), progress);

  struct Step {
    std::string name;
    std::function<void()> run;
  };
  std::vector<Step> steps;
  for (const AlignerCase& c : kCases)
    for (int n : wanted(options, c.method) ? batches_of(c, options) : std::vector<int>())
      steps.push_back({formatted("%s, %d at a time", c.method, n),
                       [&, n] { report.rows.push_back(bench_aligner(options, context, pairs, n, c)); }});
  for (int threads : kOdometryThreads)
    if (const std::shared_ptr method = make_rgbd_odometry(threads); wanted(options, method->name()))
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

}  // namespace iclk
