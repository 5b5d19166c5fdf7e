#include "apps/eval/run.h"

#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <mutex>
#include <thread>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/session/device.h>
#include <iclk/session/io/text.h>

#include "apps/eval/export.h"
#include "apps/eval/peers/methods.h"
#include "apps/iclk/session/report.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

/// A line and its pair's place in the set.
struct Work {
  const ManifestLine* line;
  PairInput pair;
  cv::Mat target_depth;
};

void require_file(const std::string& path, const std::string& where) {
  std::error_code error;
  if (path.empty() || fs::is_regular_file(path, error)) return;
  throw Error(ErrorCode::io, where + ": no such file: " + path);
}

/// "initial", then what ran; a stage that did not, or that left no error to speak of, keeps the one before. If the features do
/// not confirm the answer, the stage "pose" has the answer too.
void add_stages(EvalSample& sample, const PairInput& pair, const RefinedAlignment& result,
                const std::vector<std::string>& names) {
  const PoseError answer = pose_error(pair.camera, pair.features, result.T_10, *pair.truth);
  const bool confirmed = usable(result.status) && result.refined;
  sample.found = std::isfinite(answer.e_pixel);
  for (const std::string& name : names) {
    StageError next{name, sample.final(), false};
    for (const Stage& stage : result.stages) {
      if (stage.name != name || !sample.found) continue;
      const PoseError error = stage_error(pair, result, stage);
      if (!std::isfinite(error.e_pixel)) continue;
      next.error = error;
      next.ran = true;
    }
    if (!confirmed && sample.found && (name == "pose" || name == "structure")) next.error = answer;
    sample.stages.push_back(std::move(next));
  }
}

EvalSample begin_sample(const std::string& id, int variant, const PairInput& pair) {
  EvalSample sample;
  sample.id = id;
  sample.variant = variant;
  sample.start = pose_error(pair.camera, pair.features, pair.start(), *pair.truth);
  sample.stages = {{"initial", sample.start, true}};
  sample.nees = std::numeric_limits<double>::quiet_NaN();
  return sample;
}

/// Of a method without stages.
void finish_sample(EvalSample& sample, const std::string& method, const PeerAnswer& answer, const PairInput& pair) {
  StageError stage{method, sample.start, false};
  const PoseError error = pose_error(pair.camera, pair.features, answer.T_10, *pair.truth);
  if (answer.has_pose && std::isfinite(error.e_pixel)) {
    sample.found = stage.ran = true;
    stage.error = error;
  }
  sample.claimed = answer.claimed && sample.found;
  sample.status = !sample.found ? "no pose" : sample.claimed ? "claimed" : "refused";
  sample.stages.push_back(std::move(stage));
}

std::vector<std::string> stage_names(const SessionOptions& session) {
  std::vector<std::string> names = {"iclk"};
  if (session.refine) names.insert(names.end(), {"feature_alignment", "pose"});
  if (session.refine && session.refiner.structure) names.emplace_back("structure");
  return names;
}

PeerPair peer_pair(const PairInput& pair, const cv::Mat& target_depth) {
  PeerPair out;
  out.image_0 = pair.image_0;
  out.image_1 = pair.image_1;
  out.grey_0 = grey_8bit(pair.image_0);
  out.grey_1 = grey_8bit(pair.image_1);
  out.depth_0 = with_nan(pair.depth_0);
  out.depth_1 = with_nan(target_depth);
  out.camera = pair.camera;
  out.features = pair.features;
  out.T_10 = *pair.truth;
  out.start = pair.start();
  return out;
}

/// The classical defaults, and the paper's classical 6DoF-ICLK.
SessionOptions classical(Solver solver, bool paper) {
  AlignerOptions aligner;
  aligner.search = !paper;
  if (paper) {
    aligner.robust = Robust::unit;
    aligner.photometric = false;
    aligner.step_tolerance = 0;
  }
  return {.solver = solver, .stages = {{aligner}}, .refine = !paper};
}

class Evaluation {
 public:
  Evaluation(const std::string& set, const SessionOptions& session, const EvalOptions& options)
      : options_(options), session_(session), stages_(stage_names(session)) {
    report_.set = set;
    report_.device = session_.device_name();
    report_.model = model_name(session_.stages());
    report_.options = options;
    if (options.baselines) make_baselines();
    for (const AppearanceSpec& spec : options.appearances) {
      EvalBlock& block = report_.blocks.emplace_back(EvalBlock{spec, {}});
      block.methods.push_back({report_.model == "classical" ? "iclk" : report_.model, {}});
      for (const auto& method : baselines_) block.methods.push_back({method->name(), {}});
      for (const ForeignPoses& other : options_.others) block.methods.push_back({other.name(), {}});
    }
  }

  void run(std::span<Work> group, const std::function<void(int)>& done) {
    report_.pairs += static_cast<int>(group.size());
    for (EvalBlock& block : report_.blocks)
      for (int variant = 0; variant < options_.variants_of(block.appearance); ++variant) {
        std::vector<PairInput> pairs;
        for (const Work& work : group)
          pairs.push_back(change_pair(work.pair, block.appearance, options_, work.line->id, variant));
        run_iclk(block, group, pairs, variant);
        for (size_t i = 0; i < group.size() && !baselines_.empty(); ++i) run_baselines(block, group[i], pairs[i], variant);
        for (size_t i = 0; i < group.size(); ++i) add_others(block, group[i].line->id, pairs[i], variant);
        done(static_cast<int>(group.size()));
      }
  }

  EvalReport report() {
    // Batches bring variant after variant, people look for pair after pair.
    for (EvalBlock& block : report_.blocks)
      for (MethodSamples& method : block.methods)
        std::stable_sort(method.samples.begin(), method.samples.end(),
                         [&](const EvalSample& a, const EvalSample& b) { return order_.at(a.id) < order_.at(b.id); });
    if (options_.baselines && no_target_depth_ > 0)
      report_.note = "RgbdOdometry has no pose for " + std::to_string(no_target_depth_) + " of " +
                     std::to_string(report_.pairs) +
                     " pairs: they have no depth of the target (meta.target_depth in the manifest)";
    if (options_.baselines && no_target_depth_ == report_.pairs)
      for (EvalBlock& block : report_.blocks) block.methods.erase(block.methods.begin() + static_cast<long>(odometry_) + 1);
    return std::move(report_);
  }

  void draw(const std::string& id) { figure_ = id; }
  void place(const std::string& id) { order_.emplace(id, order_.size()); }
  bool wants_target_depth() const { return options_.baselines; }

 private:
  void make_baselines() {
    const Solver solver = session_.options().solver;
    baselines_.push_back(make_iclk_method(classical(solver, true), session_.context(), "classical (paper)"));
    if (report_.model != "classical")
      baselines_.push_back(make_iclk_method(classical(solver, false), session_.context(), "classical (ours)"));
    baselines_.push_back(make_klt_pnp());
    baselines_.push_back(make_sift_pnp());
    baselines_.push_back(make_orb_pnp());
    odometry_ = baselines_.size();
    baselines_.push_back(make_rgbd_odometry());
  }

  void run_iclk(EvalBlock& block, std::span<const Work> group, std::span<const PairInput> pairs, int variant) {
    const internal::Stopwatch watch;
    const std::vector<RefinedAlignment> results = run_pairs(session_, pairs);
    const double ms = watch.ms() / static_cast<double>(pairs.size());
    for (size_t i = 0; i < pairs.size(); ++i) {
      EvalSample sample = begin_sample(group[i].line->id, variant, pairs[i]);
      add_stages(sample, pairs[i], results[i], stages_);
      sample.status = name(results[i].status);
      sample.claimed = results[i].converged();
      if (sample.claimed) sample.nees = normalised_error(results[i].T_10, results[i].covariance, *pairs[i].truth);
      sample.ms = ms;
      if (&block == &report_.blocks.front() && variant == 0 && sample.id == figure_) {
        report_.figure = {sample.id, pairs[i], results[i]};
        report_.clean = group[i].pair;
      }
      block.methods[0].samples.push_back(std::move(sample));
    }
  }

  void run_baselines(EvalBlock& block, const Work& work, const PairInput& pair, int variant) {
    const PeerPair peer = peer_pair(pair, work.target_depth);
    if (&block == &report_.blocks.front() && variant == 0) no_target_depth_ += work.target_depth.empty();
    for (size_t m = 0; m < baselines_.size(); ++m) {
      EvalSample sample = begin_sample(work.line->id, variant, pair);
      PeerAnswer answer;
      const internal::Stopwatch watch;
      if (m != odometry_ || (!peer.depth_1.empty() && !peer.depth_0.empty())) answer = baselines_[m]->run(peer);
      sample.ms = watch.ms();
      finish_sample(sample, baselines_[m]->name(), answer, pair);
      block.methods[m + 1].samples.push_back(std::move(sample));
    }
  }

  void add_others(EvalBlock& block, const std::string& id, const PairInput& pair, int variant) {
    const size_t first = block.methods.size() - options_.others.size();
    for (size_t k = 0; k < options_.others.size(); ++k) {
      const ForeignPoses& other = options_.others[k];
      const ForeignPoses::Pose& pose = other.of(exported_id(id, block.appearance, variant));
      EvalSample sample = begin_sample(id, variant, pair);
      finish_sample(sample, other.name(), {pose.has_pose, pose.claimed, pose.T_10}, pair);
      sample.ms = pose.ms;
      block.methods[first + k].samples.push_back(std::move(sample));
    }
  }

  EvalOptions options_;
  Session session_;
  std::vector<std::string> stages_;
  std::vector<std::unique_ptr<PeerMethod>> baselines_;
  size_t odometry_ = 0;
  int no_target_depth_ = 0;
  std::string figure_;
  std::map<std::string, size_t> order_;
  EvalReport report_;
};

/// Empty where the manifest names none.
cv::Mat load_target_depth(const Manifest& manifest, const EvalLoader& loader, const ManifestLine& line) {
  const PairRequest request = parse_line(manifest, line);
  if (!request.meta.is_object() || !request.meta.contains("target_depth") || !request.meta["target_depth"].is_string())
    return {};
  return loader.target_depth(request, (fs::path(manifest.folder) / request.meta["target_depth"].get<std::string>()).string());
}

std::string figure_of(const Manifest& manifest, const EvalOptions& options, size_t count) {
  if (options.figure.empty()) return manifest.lines[count / 2].id;
  for (size_t i = 0; i < count; ++i)
    if (manifest.lines[i].id == options.figure) return options.figure;
  throw Error(ErrorCode::invalid_argument,
              "--figure '" + printable(options.figure) + "': no pair of " + manifest.path + " that is evaluated has this id");
}

}  // namespace

ApplyTo parse_apply_to(const std::string& name) {
  if (name == "reference") return ApplyTo::reference;
  if (name == "target") return ApplyTo::target;
  if (name == "both") return ApplyTo::both;
  throw Error(ErrorCode::invalid_argument,
              "--apply '" + printable(name) + "' is unknown; it must be reference, target or both");
}

void EvalOptions::check() const {
  const auto require = [](bool good, const std::string& what) {
    if (!good) throw Error(ErrorCode::invalid_argument, what);
  };
  require(!appearances.empty(), "no appearance given; clean leaves the images as they are");
  require(variants >= 1 && variants <= 10000, "--variants " + std::to_string(variants) + " must lie in 1 to 10000");
  require(batch >= 1 && batch <= 4096, "--batch " + std::to_string(batch) + " must lie in 1 to 4096");
  require(max_pairs >= 0, "--max-pairs " + std::to_string(max_pairs) + " must not be negative");
}

Manifest read_eval_set(const std::string& path) {
  std::string file = path;
  std::error_code error;
  if (fs::is_directory(path, error)) {
    file = (fs::path(path) / "pairs.jsonl").string();
    if (!fs::is_regular_file(file, error))
      throw Error(ErrorCode::io, printable(path) + " has no pairs.jsonl; give a set of `iclk render --pairs`, or a manifest");
  }
  Manifest manifest = read_manifest(file);
  for (const ManifestLine& line : manifest.lines) {
    const PairRequest request = parse_line(manifest, line);
    const std::string where = place(manifest, line);
    if (!request.truth) throw Error(ErrorCode::invalid_argument, where + ": key 'truth' is missing; errors need the true T_10");
    for (const std::string& needed :
         {request.files.reference, request.files.target, request.files.depth, request.files.features})
      require_file(needed, where);
  }
  return manifest;
}

EvalReport run_eval(const Manifest& manifest, const EvalLoader& loader, const SessionOptions& session_options,
                    const EvalOptions& options, const EvalProgress& progress) {
  options.check();
  size_t count = manifest.lines.size();
  if (options.max_pairs > 0) count = std::min(count, static_cast<size_t>(options.max_pairs));
  SessionOptions session = session_options;
  session.batch = std::min(options.batch, static_cast<int>(count));
  Evaluation evaluation(manifest.path, session, options);
  evaluation.draw(figure_of(manifest, options, count));
  std::vector<const ManifestLine*> lines;
  int variants = 0;
  for (size_t i = 0; i < count; ++i) {
    lines.push_back(&manifest.lines[i]);
    evaluation.place(manifest.lines[i].id);
  }
  for (const AppearanceSpec& spec : options.appearances) variants += options.variants_of(spec);

  // Errors keep their code; the pool knows but their words.
  std::mutex mutex;
  std::map<const ManifestLine*, Error> errors;
  const auto decode = [&](const ManifestLine& line) {
    try {
      return loader.pair(line);
    } catch (const Error& e) {
      const std::lock_guard lock(mutex);
      errors.emplace(&line, e);
      throw;
    }
  };
  PoolLimits limits;
  limits.threads = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u, 4u));
  limits.pairs = session.batch + std::max(session.batch, limits.threads);
  DecodePool pool(lines, decode, limits);
  PairGroup group;
  int done = 0;
  const int total = static_cast<int>(count) * variants;
  while (!pool.finished()) {
    pool.next(group, session.batch, std::chrono::milliseconds(100));
    std::vector<Work> work;
    for (DecodedPair& item : group.items) {
      if (!item.error.empty()) {
        const std::lock_guard lock(mutex);
        const auto found = errors.find(item.line);
        throw found != errors.end() ? found->second : Error(ErrorCode::invalid_argument, item.error);
      }
      if (!std::isfinite(pose_error(item.pair.camera, item.pair.features, item.pair.start(), *item.pair.truth).e_pixel))
        throw Error(ErrorCode::invalid_argument, place(manifest, *item.line) +
                                                     ": no feature has a depth and lies in front of both "
                                                     "the true and the first camera 1");
      cv::Mat target_depth;
      if (evaluation.wants_target_depth()) target_depth = load_target_depth(manifest, loader, *item.line);
      work.push_back({item.line, std::move(item.pair), target_depth});
    }
    if (!work.empty())
      evaluation.run(work, [&](int pairs) { progress(done += pairs, total); });
    else
      progress(done, total);
  }
  return evaluation.report();
}

}  // namespace iclk
