#pragma once
#include <iclk/depth/depth_options.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/shaders/depth/depth.h>

namespace iclk::internal {

/// Strips of rows of the reference whose volumes are in memory at a time. If there are several, strips also process kOverlap
/// rows on each inner side, whose results are not used.
struct DepthStrips {
  static constexpr int kOverlap = 64;
  int rows = 0;      ///< of the volumes
  int answered = 0;  ///< rows of results per strip; the last one may have fewer

  int count(const DepthPlan& plan) const { return (plan.height + answered - 1) / answered; }
};

/// As few strips as the device and plan.most_bytes permit. Throws Error(unsupported) with the numbers if even strips of 16 rows
/// are too large.
DepthStrips strips_of(const engine::Context& context, const DepthPlan& plan);

/// The buffers of a DepthSweep: volumes of `rows` rows, everything else of whole images.
struct DepthBuffers {
  DepthBuffers(const DepthPlan& plan, int rows, engine::MemoryPlan& memory);
  engine::BufferId views, grey, priors, census, costs, paths[ICLK_DEPTH_PATHS], corners, winners, claims, raw_planes, planes,
      read_winners, read_planes;
};

}  // namespace iclk::internal
