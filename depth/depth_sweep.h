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

/// A view beside the reference.
struct DepthSource {
  ImageView image;
  Camera camera;
  SE3 T_10;  ///< the camera of the reference to this camera, X_1 = T_10 X_0; metres
};

/// The result, for the pixels of the reference.
struct DepthMap {
  Map inverse_depth;  ///< 1/m; 0: unknown
  Map confidence;     ///< share by which the second best plane is worse, 0 to 1; 0 without inverse depth and outside all views
  double valid = 0;   ///< share of pixels that have an inverse depth
  double seen = 0;    ///< share of pixels that a view sees, averaged over the planes
  /// Share of the sparse depths that the map confirms; NaN: unknown.
  double agreeing = std::numeric_limits<double>::quiet_NaN();
  /// converged; low_overlap: the views hardly see the reference; degenerate: hardly any plane matches better than others, which
  /// suggests a wrong pose; diverged: the map contradicts most sparse depths.
  Status status = Status::degenerate;
  std::string reason = {};  ///< explains the status
};

/// Compares a map with sparse depths of the reference, and sets `agreeing`. If the map is converged, it also extends `reason`.
/// If most sparse depths then contradict the map by more than `tolerance` (1/m) and 5 %, it sets `status` to diverged. It uses
/// pixels beside each sparse depth, which priors do not affect. If fewer than 8 sparse depths have known pixels beside them, it
/// sets nothing. compute() calls it with its priors.
void compare(DepthMap& map, const Features& sparse, double tolerance);

/// Fills pixels without an inverse depth. Of the nearest known values in eight directions it takes the second smallest inverse
/// depth, because hidden surfaces lie behind the ones that hide them. The confidence stays 0. A map without any inverse depth
/// is unchanged.
void fill(DepthMap& map);

/// Computes dense depth maps of a reference image from views with known poses, on a Vulkan device: plane sweep, semi-global
/// matching, consistency between views, refinement between planes. Images are not rectified. See docs/explain/depth.md.
/// One thread at a time.
class DepthSweep {
 public:
  /// Allocates all memory. Throws the errors of DepthPlan::check() and DepthOptions::check(); Error(unsupported) with the
  /// numbers if the device or DepthPlan::most_bytes is too small even for strips; Error(out_of_memory).
  DepthSweep(std::shared_ptr<const engine::Context> context, const DepthPlan& plan, const DepthOptions& options = {});
  ~DepthSweep();
  DepthSweep(DepthSweep&&) noexcept;
  DepthSweep& operator=(DepthSweep&&) noexcept;

  /// The bytes that a DepthSweep of this plan allocates. Throws the errors of the constructor, except Error(out_of_memory).
  static engine::MemoryBytes memory(const engine::Context& context, const DepthPlan& plan);

  /// Computes a depth map and waits for it. Images must have the size of the plan; 1 to DepthPlan::views sources. `priors` may
  /// be empty; those outside the image or without a positive, finite inverse depth are ignored. Throws Error(invalid_argument)
  /// that names the image, for a wrong size, an invalid camera, and a pose that is not finite or has no translation. Throws
  /// Error(device_lost).
  DepthMap compute(const ImageView& reference, const Camera& camera, std::span<const DepthSource> sources,
                   const DepthRange& range, const Features& priors = {});

  const DepthPlan& plan() const;
  int strips() const;  ///< the number of strips of rows; 1: the whole image at once
  /// Device time by stage, summed over the calls.
  const std::vector<engine::StageTime>& times() const;

 private:
  friend struct internal::DepthStages;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
