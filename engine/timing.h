#pragma once
#include <string>

namespace iclk::engine {

/// The device time of a stage.
struct StageTime {
  std::string name;
  double milliseconds = 0;  ///< sum over `count` runs
  int count = 0;            ///< how often the stage ran
};

}  // namespace iclk::engine
