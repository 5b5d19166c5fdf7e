#pragma once
#include <cstdint>
#include <vector>

#include <iclk/depth/depth_sweep.h>

namespace iclk::internal {

/// What the stages left of the last DepthSweep::compute(), for tests.
struct DepthStages {
  /// Costs, and the sums of a path: a byte a plane, of the last strip.
  static std::vector<uint8_t> volume(const DepthSweep& sweep);
  static std::vector<uint8_t> path(const DepthSweep& sweep, int index);
  /// Signatures of the census, the reference first.
  static std::vector<uint32_t> census(const DepthSweep& sweep);
};

}  // namespace iclk::internal
