#pragma once
#include <cstdint>
#include <vector>

#include <iclk/depth/depth_sweep.h>

namespace iclk::internal {

/// Intermediate results of the last DepthSweep::compute(), for tests.
struct DepthStages {
  /// The costs of the last strip, one byte per plane.
  static std::vector<uint8_t> volume(const DepthSweep& sweep);
  /// The sums of a path of the last strip, one byte per plane.
  static std::vector<uint8_t> path(const DepthSweep& sweep, int index);
  /// The census signatures, the reference first.
  static std::vector<uint32_t> census(const DepthSweep& sweep);
};

}  // namespace iclk::internal
