#pragma once
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <iclk/align/alignment.h>
#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/depth/depth_options.h>
#include <iclk/engine/context.h>
#include <iclk/engine/resources.h>
#include <iclk/engine/timing.h>

namespace iclk {
namespace internal {
struct DepthStages;
}

/// An image beside the reference.
struct DepthSource {
  ImageView image;
  Camera camera;
  SE3 T_10;  ///< takes points of the reference's camera to this one, X_1 = T_10 X_0; metres
};

/// Of the reference's pixels.
struct DepthMap {
  Map inverse_depth;  ///< 1/m; 0: none
  Map confidence;     ///< share by which the second best plane is worse, 0 to 1; 0 without inverse depth, and outside all views
  double valid = 0;   ///< share of pixels that have an inverse depth
  double seen = 0;    ///< share of pixels that a view sees, in the mean over the planes
  /// Share of the sparse depths that the map confirms; NaN: unknown.
  double agreeing = std::numeric_limits<double>::quiet_NaN();
  /// converged; low_overlap: the views hardly see the reference; degenerate: hardly a plane matches better than others, as it
  /// is where a pose is wrong; diverged: the map contradicts most sparse depths.
  Status status = Status::degenerate;
  std::string reason = {};  ///< the status in words
};

/// Compares a map with sparse depths of the reference and says what comes of it in `agreeing`, `reason` and, where most
/// contradict it by more than `tolerance` (1/m) and 5 %, in `status`. It looks beside each sparse depth, where a prior has no
/// say. Fewer than 8 that have answers beside them say nothing. compute() does so with its priors.
void compare(DepthMap& map, const Features& sparse, double tolerance);

/// Gives pixels without an inverse depth one, of what lies around: along eight ways the nearest answers are looked for, and the
/// second least inverse depth is taken, since what is hidden in the views lies behind what hides it. Their confidence stays 0.
/// A map without any answer stays as it is.
void fill(DepthMap& map);

/// A dense depth map of a reference image from views whose poses are known, on a Vulkan device: plane sweep, semi-global
/// matching, consistency between views, refinement between planes. Nothing is rectified. docs/explain/depth.md says how.
/// One thread at a time.
class DepthSweep {
 public:
  /// Allocates everything. Throws Error(invalid_argument) of DepthPlan::check() and DepthOptions::check(), Error(unsupported)
  /// with the numbers for what the device or DepthPlan::most_bytes cannot hold even in strips, Error(out_of_memory).
  DepthSweep(std::shared_ptr<const engine::Context> context, const DepthPlan& plan, const DepthOptions& options = {});
  ~DepthSweep();
  DepthSweep(DepthSweep&&) noexcept;
  DepthSweep& operator=(DepthSweep&&) noexcept;

  /// Bytes that a DepthSweep of this plan allocates. Throws as the constructor does, but for memory.
  static engine::MemoryBytes memory(const engine::Context& context, const DepthPlan& plan);

  /// Computes and waits. Images have the plan's size, sources are 1 to DepthPlan::views. `priors` may be empty; those outside
  /// the image, and those whose inverse depth is not positive and finite, are passed over. Throws Error(invalid_argument) that
  /// names the image: another size, an invalid camera, a pose that is not finite or does not move the camera;
  /// Error(device_lost).
  DepthMap compute(const ImageView& reference, const Camera& camera, std::span<const DepthSource> sources,
                   const DepthRange& range, const Features& priors = {});

  const DepthPlan& plan() const;
  int strips() const;  ///< that the rows are taken in; 1: all at once
  /// Device time by stage, summed over the calls.
  const std::vector<engine::StageTime>& times() const;

 private:
  friend struct internal::DepthStages;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
