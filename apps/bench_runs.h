#pragma once
#include <memory>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/timing.h>

#include "apps/bench_measure.h"
#include "apps/peers_methods.h"

namespace iclk {

struct BenchOptions {
  std::vector<int> pairs = {1, 4, 16, 64};  ///< batch sizes
  int repetitions = 5;                      ///< of every figure
  int features = 50;
  int width = 640, height = 480;
  std::vector<std::string> only;  ///< methods to measure, BenchRow::method; empty: all
  bool profile = false;           ///< device time by stage

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// One line of the table: references and targets from host memory to poses in host memory, nothing kept from call to call but
/// the plan.
struct BenchRow {
  std::string method;  ///< "device", "host", "cpu", "device, colour", "device + refine", "device, unit weights",
                       ///< "device + search",
                       ///< "RgbdOdometry", ...
  std::string format;  ///< of the images on the device; empty for OpenCV
  int pairs = 0;       ///< in one call
  int calls = 0;       ///< that were timed
  Spread wall;         ///< ms a pair
  double cpu = 0;      ///< ms of processor time a pair, median
  int converged = 0;   ///< pairs of the last repetition that say so, of `run`
  int run = 0;
  double error = 0;  ///< px, median over these pairs of the mean reprojection error at the features
};

/// Where a call of the device solver spends its time, ms a pair.
struct BenchProfile {
  int pairs = 0;
  std::vector<engine::StageTime> stages;  ///< milliseconds a pair; count: times entered a call
  double set_reference = 0;               ///< on the host: copies of pixels and features
  double wall = 0;                        ///< of the whole call
};

struct BenchReport {
  Machine machine;
  BenchOptions options;
  std::vector<BenchRow> rows;
  std::vector<BenchProfile> profiles;
};

/// BenchRow::method of every row that there can be.
std::vector<std::string> bench_methods();

/// Distinct pairs of images made in code (apps/scene): motions of up to 3.3 degrees and 8 cm at 2 m, each forwards, backwards
/// and mirrored in four ways, so eight pairs a rendering. All images are drawn with their own noise and lie in memory of their
/// own.
std::vector<PeerPair> make_bench_pairs(const BenchOptions& options, int count, const Progress& progress);

/// Throws Error for bad options or a failing device.
BenchReport run_bench(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, const Progress& progress);

/// ms a pair of `method` at that many pairs, or NaN.
double bench_wall(const BenchReport& report, const std::string& method, int pairs);

nlohmann::ordered_json to_json(const BenchReport& report);
std::string to_table(const BenchReport& report);

}  // namespace iclk
