#pragma once
#include <memory>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/timing.h>
#include <iclk/refine/refiner.h>

#include "apps/eval/bench/pairs.h"
#include "apps/eval/common/machine.h"
#include "apps/eval/peers/methods.h"
#include "apps/iclk/common/progress.h"

namespace iclk {

struct BenchOptions {
  std::vector<int> pairs = {1, 4, 16, 64};  ///< batch sizes
  int repetitions = 5;                      ///< of every figure
  int features = 50;
  int width = 640, height = 480;
  /// Methods to measure, BenchRow::method; empty: with a model all of its own, without all that need none.
  std::vector<std::string> only;
  std::shared_ptr<const Model> model;  ///< null: the classical mode
  bool profile = false;                ///< device time by stage

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// One line of the table: references and targets from host memory to poses in host memory, nothing kept from call to call but
/// the plan.
struct BenchRow {
  std::string method;  ///< "device", "host", "cpu", "device, colour", "device + refine", "device, unit weights",
                       ///< "device + search", "RgbdOdometry", ...; "model, device" and more of bench_methods()
  std::string format;  ///< of the images on the device; empty for OpenCV
  int pairs = 0;       ///< in one call
  int calls = 0;       ///< that were timed
  Spread wall;         ///< ms a pair
  double cpu = 0;      ///< ms of processor time a pair, median
  int converged = 0;   ///< pairs of the last repetition that say so, of `run`
  int run = 0;
  double error = 0;  ///< px, median over these pairs of the mean reprojection error at the features
};

/// Where a call of the device solver spends its time, ms a pair; with a model: with search and refinement.
struct BenchProfile {
  int pairs = 0;
  bool model = false;
  std::vector<engine::StageTime> stages;  ///< milliseconds a pair; count: times entered a call
  double set_reference = 0;               ///< on the host: copies of pixels and features
  std::vector<Stage> refinement;          ///< wall time of its stages, ms a pair
  double wall = 0;                        ///< of the whole call
  double encoder_gmac = 0;                ///< of an image, as direct convolutions count; 0 without a model
  double encoder_gflops = 0;              ///< 10^9 multiplications and additions a second while encoding, counted likewise
};

struct BenchReport {
  Machine machine;
  BenchOptions options;
  std::vector<BenchRow> rows;
  std::vector<BenchProfile> profiles;
};

/// BenchRow::method of every row that there can be.
std::vector<std::string> bench_methods();

/// Throws Error for bad options or a failing device.
BenchReport run_bench(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, const Progress& progress);

/// ms a pair of `method` at that many pairs, or NaN.
double bench_wall(const BenchReport& report, const std::string& method, int pairs);

/// write_pair() of the first pair and what "model, device" (without a model "device") makes of it. Throws Error(io).
void save_bench_pair(const BenchOptions& options, const std::shared_ptr<engine::Context>& context, const std::string& path);

nlohmann::ordered_json to_json(const BenchReport& report);
std::string to_table(const BenchReport& report);

}  // namespace iclk
