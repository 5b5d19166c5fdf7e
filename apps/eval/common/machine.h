#pragma once
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/engine/context.h>

namespace iclk {

/// Samples of one quantity, ms a pair.
struct Spread {
  double median = 0, min = 0, max = 0;
};

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

}  // namespace iclk
