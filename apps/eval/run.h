#pragma once
#include <functional>
#include <string>
#include <vector>

#include "apps/eval/appearance_draw.h"
#include "apps/eval/metrics.h"
#include "apps/eval/peers/foreign_poses.h"
#include "apps/iclk/batch/pool.h"
#include "apps/iclk/session/run_pairs.h"

namespace iclk {

/// Which image of a pair the changes are applied to. Both: each gets its own.
enum class ApplyTo { reference, target, both };
/// Throws Error(invalid_argument) that lists the names.
ApplyTo parse_apply_to(const std::string& name);

struct EvalOptions {
  std::vector<AppearanceSpec> appearances = {{}};  ///< each is a block of the report
  int variants = 10;                               ///< of a pair, where something is drawn; 1 of a clean one
  ApplyTo apply = ApplyTo::target;
  uint64_t seed = 0;
  bool baselines = false;
  int batch = 8;                     ///< pairs on the device at a time
  int max_pairs = 0;                 ///< the first so many lines; 0: all
  std::string figure;                ///< id of the pair to draw; empty: the one in the middle of the set
  std::vector<ForeignPoses> others;  ///< rows of methods that ran elsewhere

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
  int variants_of(const AppearanceSpec& spec) const { return spec.clean() ? 1 : variants; }
};

struct MethodSamples {
  std::string method;
  std::vector<EvalSample> samples;  ///< variants of a pair one after another, pairs in the order of the set
};

struct EvalBlock {
  AppearanceSpec appearance;
  std::vector<MethodSamples> methods;  ///< what was asked for first, then the baselines, then the others
};

/// One pair with what became of it, to be drawn.
struct EvalFigure {
  std::string id;
  PairInput pair;  ///< as it was aligned
  RefinedAlignment result;
};

struct EvalReport {
  std::string set, device, model;
  EvalOptions options;
  int pairs = 0;
  std::vector<EvalBlock> blocks;
  EvalFigure figure;  ///< of the first block, variant 0
  PairInput clean;    ///< the same pair before any change
  std::string note;   ///< what could not be measured and why; empty if all could
};

/// The manifest of a set: a file is taken as it is, of a folder its pairs.jsonl. Everything that can be known without decoding
/// an image is checked: every line is well-formed, has a truth, and its files are there.
/// Throws Error(io) for a missing file or folder, Error(invalid_argument) for a bad line or one without truth, each with
/// "<manifest>:<line>".
Manifest read_eval_set(const std::string& path);

/// Called after each step with what is done of what there is.
using EvalProgress = std::function<void(int done, int total)>;

/// How lines become pairs; called from several threads.
struct EvalLoader {
  std::function<DecodedPair(const ManifestLine&)> pair;
  std::function<cv::Mat(const PairRequest&, const std::string& file)> target_depth;  ///< CV_32FC1 metres, 0 = none
};

/// Throws Error: a pair that cannot be read or aligned ends the run, since a mean over the rest would be another set's.
EvalReport run_eval(const Manifest& manifest, const EvalLoader& loader, const SessionOptions& session,
                    const EvalOptions& options, const EvalProgress& progress);

}  // namespace iclk
