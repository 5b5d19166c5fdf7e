#pragma once
#include <cstdint>
#include <limits>
#include <span>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk {

/// The sizes of a DepthSweep. It allocates its memory once, for these: about 9 width height planes bytes for the volumes, and
/// about 30 width height (views + 1) bytes for the rest.
struct DepthPlan {
  int width = 0, height = 0;  ///< pixels of every image
  int planes = 128;           ///< of inverse depth; a multiple of 16, 16 to 256
  int views = 1;              ///< beside the reference, at most; 1 to 8
  /// The most bytes to allocate; 0: up to the memory of the device. If this is too little, strips of rows that overlap by 64
  /// are computed one after the other. The results are nearly the same (docs/results/depth.md).
  uint64_t most_bytes = 0;

  /// Throws Error(invalid_argument) that names the value and its range. The longer side times planes / 16 must not exceed
  /// 60,000, the most loop iterations that Mesa 22.3 runs.
  void check() const;
};

struct DepthOptions {
  int p1 = 7;                ///< penalty for neighbours that differ by one plane; costs are 0 to 31 per path
  int p2 = 60;               ///< penalty for neighbours that differ by more
  double edge = 3;           ///< how much p2 falls per grey level (of 255) of difference, to p1 + 1 at least
  double uniqueness = 0.01;  ///< share by which the second best plane, not adjacent to the best, must be worse
  double tolerance = 3;      ///< planes by which views may disagree with the reference
  bool keep_unseen = false;  ///< pixels outside all views keep the plane of their neighbours, with confidence 0
  int iterations = 3;        ///< of the refinement between planes; 0: none
  int speckle = 100;         ///< connected regions of fewer pixels are removed; 0: keep all
  double speckle_step = 1;   ///< planes between connected neighbours, at most

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// The range in which depth is searched.
struct DepthRange {
  double near = 0;                                       ///< m, > 0
  double far = std::numeric_limits<double>::infinity();  ///< m, > near; may be infinite

  void check() const;
};

/// The number of planes that a range needs: from one plane to the next, no pixel of the reference moves by more than about
/// `pixels` in any view. It is rounded up to a multiple of 16 and at most 256. Preconditions: cameras and range pass check().
int planes_for(const Camera& reference, std::span<const Camera> cameras, std::span<const SE3> T_10, const DepthRange& range,
               double pixels = 0.7);

/// The range of the given inverse depths, widened on both sides by `margin` (a share of the inverse depth). The outermost 1 %
/// of the depths are ignored. Throws Error(invalid_argument) if none is positive and finite.
DepthRange range_of(std::span<const double> inverse_depths, double margin = 0.25);

}  // namespace iclk
