#pragma once
#include <cstdint>
#include <limits>
#include <span>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk {

/// The sizes for which a DepthSweep allocates its memory, once: about 9 width height planes bytes for the volumes and
/// about 30 width height (views + 1) besides.
struct DepthPlan {
  int width = 0, height = 0;  ///< pixels of every image
  int planes = 128;           ///< of inverse depth, a multiple of 16, 16 to 256
  int views = 1;              ///< beside the reference, at most; 1 to 8
  /// That it may allocate; 0: what the device holds. With less, it walks through strips of rows that overlap by 64, one after
  /// the other: nearly the same answers (docs/results/depth.md).
  uint64_t most_bytes = 0;

  /// Throws Error(invalid_argument) that names the value and its range: also where the longer side times planes / 16 is more
  /// than 60,000, which is what an invocation of Mesa 22.3 can go round.
  void check() const;
};

struct DepthOptions {
  int p1 = 7;                ///< penalty where neighbours differ by a plane; costs are 0 to 31 a path
  int p2 = 60;               ///< where they differ by more
  double edge = 3;           ///< p2 falls by so much a grey level (of 255) of difference, to p1 + 1 at least
  double uniqueness = 0.01;  ///< share by which the second best plane, not beside the best, must be worse
  double tolerance = 3;      ///< planes by which views may disagree with the reference
  bool keep_unseen = false;  ///< what lies outside every view keeps the plane that its neighbours suggest, confidence 0
  int iterations = 3;        ///< of the refinement between planes; 0: none
  int speckle = 100;         ///< connected pixels of fewer are dropped; 0: none
  double speckle_step = 1;   ///< planes between connected neighbours, at most

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Where depth is looked for.
struct DepthRange {
  double near = 0;                                       ///< m, > 0
  double far = std::numeric_limits<double>::infinity();  ///< m, > near; infinity is a plane like others

  void check() const;
};

/// Planes with which no pixel of the reference moves by more than about `pixels` in any view from a plane to the next, rounded
/// up to a multiple of 16, at most 256. Preconditions: cameras and range pass check().
int planes_for(const Camera& reference, std::span<const Camera> cameras, std::span<const SE3> T_10, const DepthRange& range,
               double pixels = 0.7);

/// The range of depths, widened by `margin` (share of inverse depth) to either side. The outermost 1 % of the depths do not
/// count. Throws Error(invalid_argument) where none is positive and finite.
DepthRange range_of(std::span<const double> inverse_depths, double margin = 0.25);

}  // namespace iclk
