#pragma once
#include <string>

namespace iclk::engine {

struct StageTime {
  std::string name;
  double milliseconds = 0;  ///< on the device, summed over `count`
  int count = 0;            ///< times that the stage was entered
};

}  // namespace iclk::engine
