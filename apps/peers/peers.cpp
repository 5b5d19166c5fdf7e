#include "apps/peers/peers.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <numbers>

#include <iclk/engine/error.h>
#include <iclk/session/pose_errors.h>

#include "apps/common/format.h"
#include "apps/io/images.h"
#include "apps/io/sequence.h"
#include "apps/session/pair_input.h"

namespace iclk {
namespace {

const char* const kTum = "tum_fr1_360_5";
const char* const kHololens = "hololens_80";

struct Case {
  std::string data, distortion;
  int stride = 1;
};

/// The pairs of a sequence that have a truth and depth of both images, at most `most` of them, evenly spread.
struct PairSource {
  Sequence sequence;
  std::vector<SequencePair> pairs;
  std::unique_ptr<PairLoader> loader;

  PairSource(const std::string& root, const Case& c, const PeerOptions& options) {
    sequence = load_sequence((std::filesystem::path(root) / c.data).string());
    if (!sequence.camera) throw Error(ErrorCode::io, sequence.folder + "/camera.txt is missing");
    for (SequencePair& pair : make_pairs(sequence, c.stride))
      if (pair.T_10 && !target_depth(pair).empty()) pairs.push_back(std::move(pair));
    if (pairs.empty())
      throw Error(ErrorCode::invalid_argument, sequence.folder + ": no pair has depth of both images and a truth");
    if (options.max_pairs > 0 && pairs.size() > static_cast<size_t>(options.max_pairs)) {
      std::vector<SequencePair> some;
      for (size_t i = 0; i < static_cast<size_t>(options.max_pairs); ++i)
        some.push_back(pairs[i * pairs.size() / static_cast<size_t>(options.max_pairs)]);
      pairs = std::move(some);
    }
    InputOptions input;
    input.camera = *sequence.camera;
    if (!c.distortion.empty()) input.distortion = parse_distortion(c.distortion);
    input.detector.count = options.features;
    loader = std::make_unique<PairLoader>(input);
  }

  const std::string& target_depth(const SequencePair& pair) const {
    return sequence.frames[static_cast<size_t>(pair.frame_1)].depth;
  }

  PeerPair load(const SequencePair& files) const {
    const PairInput input = loader->load({files.reference, files.target, files.depth, ""});
    const PairInput target = loader->load({files.target, files.target, target_depth(files), ""});
    PeerPair pair;
    pair.image_0 = input.image_0;
    pair.image_1 = input.image_1;
    pair.grey_0 = grey_8bit(input.image_0);
    pair.grey_1 = grey_8bit(input.image_1);
    pair.depth_0 = with_nan(input.depth_0);
    pair.depth_1 = with_nan(target.depth_0);
    pair.camera = input.camera;
    pair.features = input.features;
    pair.T_10 = *files.T_10;
    return pair;
  }
};

/// Every method on one pair, in their order.
std::vector<PeerSample> run_methods(std::span<const std::unique_ptr<PeerMethod>> methods, const PeerPair& pair,
                                    const SequencePair& files) {
  constexpr double inf = std::numeric_limits<double>::infinity();
  std::vector<PeerSample> samples;
  std::vector<PeerAnswer> answers;
  for (const auto& method : methods) {
    PeerSample& sample = samples.emplace_back(PeerSample{files.frame_0, files.frame_1, false, false, inf, inf, inf, 0});
    const Stopwatch watch;
    const PeerAnswer& answer = answers.emplace_back(method->run(pair));
    sample.ms = watch.wall_ms();
    sample.claimed = answer.claimed;
    if (!answer.has_pose) continue;
    const PoseError error = pose_error(pair.camera, pair.features, answer.T_10, pair.T_10);
    if (std::isfinite(error.e_pixel)) sample.e_pixel = error.e_pixel;
    sample.e_transl = error.e_transl;
    sample.e_rot = error.e_rot;
  }
  for (size_t i = 0; i < methods.size(); ++i)
    for (size_t k = 0; k < methods.size(); ++k)
      if (answers[i].has_pose && answers[k].claimed && methods[i]->family() != methods[k]->family())
        samples[i].supported |= pose_error(pair.camera, pair.features, answers[i].T_10, answers[k].T_10).e_pixel < 1;
  return samples;
}

PeerRow summarize(const std::string& method, std::vector<PeerSample> samples) {
  PeerRow row;
  row.method = method;
  for (const PeerSample& s : samples) {
    row.within_1px += s.e_pixel < 1;
    row.within_3px += s.e_pixel < 3;
    row.claimed += s.claimed;
    row.claimed_wrong += s.claimed && s.e_pixel > 3;
    row.claimed_alone += s.claimed && s.e_pixel > 3 && !s.supported;
  }
  const auto median_of = [&](double PeerSample::*member) {
    std::vector<double> values;
    for (const PeerSample& s : samples) values.push_back(s.*member);
    return median(values);
  };
  row.e_pixel = median_of(&PeerSample::e_pixel);
  row.e_transl = median_of(&PeerSample::e_transl);
  row.e_rot = median_of(&PeerSample::e_rot);
  row.ms = median_of(&PeerSample::ms);
  row.samples = std::move(samples);
  return row;
}

std::vector<std::unique_ptr<PeerMethod>> make_methods(const PeerOptions& options) {
  std::vector<std::unique_ptr<PeerMethod>> methods;
  for (const bool refine : {false, true}) {
    SessionOptions iclk = options.iclk;
    iclk.refine = refine;
    methods.push_back(make_iclk_method(iclk, options.context));
  }
  methods.push_back(make_rgbd_odometry());
  methods.push_back(make_klt_pnp());
  methods.push_back(make_sift_pnp());
  return methods;
}

const char* solver_name(Solver solver) { return solver == Solver::host ? "host" : solver == Solver::device ? "device" : "cpu"; }

}  // namespace

void PeerOptions::check() const {
  const auto require = [](bool good, const std::string& what) {
    if (!good) throw Error(ErrorCode::invalid_argument, what);
  };
  for (int stride : strides) require(stride >= 1, "--strides " + std::to_string(stride) + " must be at least 1");
  require(max_pairs >= 0, "--max-pairs " + std::to_string(max_pairs) + " must not be negative");
  require(features >= 1 && features <= 10000, "--features " + std::to_string(features) + " must lie in 1 to 10000");
  if (!distortion.empty()) parse_distortion(distortion);
  for (const ModelStage& stage : iclk.stages) stage.aligner.check();
  iclk.refiner.check();
}

std::string find_data(const std::string& option) {
  const char* variable = std::getenv("ICLK_DATA");
  const std::string folder = !option.empty() ? option : variable && *variable ? variable : "../shared/data";
  for (const char* name : {kTum, kHololens}) {
    std::error_code ignored;
    if (std::filesystem::is_directory(std::filesystem::path(folder) / name, ignored)) continue;
    throw Error(ErrorCode::io, "no folder " + (std::filesystem::path(folder) / name).string() +
                                   ": name the folder that holds " + kTum + " and " + kHololens + " with --data or ICLK_DATA");
  }
  return folder;
}

PeerReport run_peers(const PeerOptions& options, const Progress& progress) {
  options.check();
  const std::string root = find_data(options.data);
  std::vector<Case> cases = {{kTum, "", 1}};
  if (!options.distortion.empty()) cases.push_back({kTum, options.distortion, 1});
  for (int stride : options.strides) cases.push_back({kHololens, "", stride});
  std::vector<PairSource> sources;
  int total = 0, done = 0;
  for (const Case& c : cases) total += static_cast<int>(sources.emplace_back(root, c, options).pairs.size());

  PeerReport report;
  report.options = options;
  report.machine = describe_machine(options.context.get());
  for (size_t i = 0; i < cases.size(); ++i) {
    const PairSource& source = sources[i];
    const auto methods = make_methods(options);
    std::vector<std::vector<PeerSample>> samples(methods.size());
    for (const SequencePair& files : source.pairs) {
      progress(cases[i].data + " stride " + std::to_string(cases[i].stride), done++, total);
      const PeerPair pair = source.load(files);
      if (samples[0].empty())
        for (const auto& method : methods) method->run(pair);  // makes what is made once
      const std::vector<PeerSample> of_pair = run_methods(methods, pair, files);
      for (size_t m = 0; m < methods.size(); ++m) samples[m].push_back(of_pair[m]);
    }
    PeerBlock block{cases[i].data,
                    cases[i].distortion.empty() ? "as in camera.txt" : cases[i].distortion,
                    cases[i].stride,
                    static_cast<int>(source.pairs.size()),
                    {}};
    for (size_t m = 0; m < methods.size(); ++m) block.rows.push_back(summarize(methods[m]->name(), std::move(samples[m])));
    report.blocks.push_back(std::move(block));
  }
  progress("", total, total);
  return report;
}

nlohmann::ordered_json to_json(const PeerReport& report) {
  using Json = nlohmann::ordered_json;
  Json blocks = Json::array();
  for (const PeerBlock& b : report.blocks) {
    Json rows = Json::array();
    for (const PeerRow& r : b.rows) {
      Json each = Json::array();
      for (const PeerSample& p : r.samples)
        each.push_back({{"frames", {p.frame_0, p.frame_1}},
                        {"claimed", p.claimed},
                        {"supported", p.supported},
                        {"e_pixel", number(p.e_pixel)},
                        {"e_transl", number(p.e_transl)},
                        {"e_rot", number(p.e_rot)},
                        {"ms", number(p.ms)}});
      rows.push_back({{"method", r.method},
                      {"within_1px", r.within_1px},
                      {"within_3px", r.within_3px},
                      {"claimed", r.claimed},
                      {"claimed_but_over_3px", r.claimed_wrong},
                      {"claimed_but_over_3px_alone", r.claimed_alone},
                      {"median_e_pixel", number(r.e_pixel)},
                      {"median_e_transl", number(r.e_transl)},
                      {"median_e_rot", number(r.e_rot)},
                      {"ms_per_pair", number(r.ms)},
                      {"each", each}});
    }
    blocks.push_back({{"data", b.data}, {"camera", b.camera}, {"stride", b.stride}, {"pairs", b.pairs}, {"methods", rows}});
  }
  return {{"machine", to_json(report.machine)},
          {"features", report.options.features},
          {"solver", solver_name(report.options.iclk.solver)},
          {"blocks", blocks}};
}

std::string to_table(const PeerReport& report) {
  std::string out = to_line(report.machine);
  out += formatted("%d features, iclk with --solver %s. Medians are over all pairs, one without a pose counts as infinite.\n",
                   report.options.features, solver_name(report.options.iclk.solver));
  out +=
      "claims: the method says that it succeeded; wrong: of these, more than 3 px off the truth; alone: of these, those that "
      "no other kind\n"
      "of method agrees with to 1 px (where others agree, the truth is in doubt).\n";
  for (const PeerBlock& b : report.blocks) {
    out += formatted("\n%s, stride %d, %d pairs, camera %s\n", b.data.c_str(), b.stride, b.pairs, b.camera.c_str());
    out += "method             < 1 px   < 3 px  claims  wrong  alone  median px       mm      deg  ms a pair\n";
    for (const PeerRow& r : b.rows)
      out += formatted("%-16s %7.0f%% %7.0f%%  %6d  %5d  %5d  %9.2f %8.1f %8.2f  %9.1f\n", r.method.c_str(),
                       100.0 * r.within_1px / b.pairs, 100.0 * r.within_3px / b.pairs, r.claimed, r.claimed_wrong,
                       r.claimed_alone, r.e_pixel, 1e3 * r.e_transl, r.e_rot * 180 / std::numbers::pi, r.ms);
  }
  return out;
}

}  // namespace iclk
