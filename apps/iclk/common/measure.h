#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/engine/context.h>

namespace iclk {

/// Wall time, and processor time (user and system) of all threads of this process: what other processes hardly disturb. A
/// software device runs in this process, a GPU does not.
class Stopwatch {
 public:
  Stopwatch() { restart(); }
  void restart();
  double wall_ms() const;
  double cpu_ms() const;

 private:
  double wall_ = 0, cpu_ = 0;
};

/// Samples of one quantity, ms a pair.
struct Spread {
  double median = 0, min = 0, max = 0;
};

/// The mean of the middle two for an even count; NaN for none. Infinite values sort last.
double median(std::vector<double> values);
Spread spread(const std::vector<double>& values);

/// Where a figure was measured.
struct Machine {
  std::string device, driver, processor;
  int cores = 0;           ///< that this process may use
  double cores_got = 0;    ///< of these, what it got when the measurement began: other processes take the rest
  int opencv_threads = 0;  ///< OpenCV's own choice
  double load = 0;         ///< average of the last minute when the measurement began
};
/// Keeps every core busy for a quarter of a second. `context`: null where no Vulkan device takes part.
Machine describe_machine(const engine::Context* context);
nlohmann::ordered_json to_json(const Machine& machine);
std::string to_line(const Machine& machine);

/// Told after every step of a long run: what is done now, steps done, steps in all.
using Progress = std::function<void(const std::string& what, int done, int total)>;

/// A bar on standard error, redrawn in place; nothing where standard error is no terminal.
Progress terminal_progress();

/// A number for JSON: null unless finite.
nlohmann::ordered_json number(double value);

}  // namespace iclk
