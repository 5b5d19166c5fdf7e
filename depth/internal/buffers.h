#pragma once
#include <iclk/depth/depth_options.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/shaders/depth/depth.h>

namespace iclk::internal {

/// Rows of the reference whose volumes lie in memory at a time. Where they are not all, each strip but the outermost has
/// kOverlap rows on either side that it walks along and does not answer.
struct DepthStrips {
  static constexpr int kOverlap = 64;
  int rows = 0;      ///< of the volumes
  int answered = 0;  ///< rows a strip answers; the last one may have fewer

  int count(const DepthPlan& plan) const { return (plan.height + answered - 1) / answered; }
};

/// As few strips as the device and plan.most_bytes permit. Throws Error(unsupported) with the numbers where strips of 16 rows
/// are too much.
DepthStrips strips_of(const engine::Context& context, const DepthPlan& plan);

/// The buffers of a DepthSweep: volumes of `rows` rows, all else of whole images.
struct DepthBuffers {
  DepthBuffers(const DepthPlan& plan, int rows, engine::MemoryPlan& memory);
  engine::BufferId views, grey, priors, census, costs, paths[ICLK_DEPTH_PATHS], corners, winners, claims, raw_planes, planes,
      read_winners, read_planes;
};

}  // namespace iclk::internal
