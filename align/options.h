#pragma once
#include <iclk/align/image.h>

namespace iclk {

enum class Solver {
  host,    ///< sums on the device, 6x6 system on the host, one read-back per iteration for the whole batch
  device,  ///< everything in shaders, one submission per batch
  cpu,     ///< the CPU reference: plain C++ and Eigen, no Vulkan
};

/// Robust weights of the residuals. They are computed once per level, from the residuals at its start; the scale is their
/// median absolute value. `unit` is the paper's choice; the others reduce the weight of moving and occluded pixels.
enum class Robust { unit, huber, tukey, cauchy };

enum class Damping {
  fixed,     ///< (H + lambda D) xi = g, every step is taken, as in the paper
  adaptive,  ///< Levenberg-Marquardt: a step that raises the cost is undone, lambda follows the gain ratio
};

/// How to align. Defaults: the classical mode (grey pyramid) with gain and bias, and Huber's weights.
struct AlignerOptions {
  int levels = 4;
  int iterations = 10;   ///< at most, per level
  double lambda = 1e-6;  ///< damping, or its start value
  Damping damping = Damping::fixed;
  Robust robust = Robust::huber;
  bool photometric = true;  ///< estimate gain a and bias b of the pair: r = f1(warp) - (a f0 + b)
  /// How much of a level's pose information (0 to 1) the next finer level keeps as a prior; helps with blur and noise. The
  /// information is H / variance of the residuals. 0: none, as in the paper. Above 0, the PosePrior of a pair is passed on in
  /// the same way from the coarsest level. It is then weighed against that variance instead of residual_sigma^2.
  double carry = 0;
  /// A level ends early when a step moves none of its pixels by more than this (px of that level). 0: never, as in the paper.
  double step_tolerance = 0.003;
  int min_features = 6;          ///< fewer usable features: Status::too_few_features
  double min_visible = 0.3;      ///< a smaller share of patch pixels inside the target: Status::low_overlap
  double min_correlation = 0.4;  ///< a smaller final correlation of f0 and the warped f1: Status::diverged
  /// A smaller final correlation of both images' gradients in the worst direction of the pose: Status::degenerate, because
  /// the texture that both images share does not determine the pose. Right poses of real pairs have 0.1 to 0.9. Wrong ones,
  /// and edges of one direction in noise, have at most 0.06.
  double min_agreement = 0.1;
  /// Searches the whole target for a start of pairs without a first guess. It matches each feature's patch in grey values,
  /// with rolls of up to 0.5 rad. Sets of three matches give poses; all matches score them, and the best pose is refined. If
  /// enough matches agree with it, the pair starts there, at a fine level; else at its first guess. Sparse mode only.
  bool search = false;
  double residual_sigma = 0.02;  ///< standard deviation of a residual, feature units: its weight relative to a prior

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// The sizes of an aligner. It allocates its memory once, for these.
struct Plan {
  int width = 0, height = 0;  ///< of every image
  int max_features = 50;      ///< of a reference
  int max_references = 1;     ///< prepared references (keyframes) at a time
  int max_pairs = 1;          ///< pairs of one batch; larger spans are split
  bool dense = false;         ///< every pixel with depth instead of patches around features
  /// The format on the device: r8, rgba8, bgra8, r32f or rgba32f. Host pixels are converted to it.
  PixelFormat format = PixelFormat::rgba8;
  /// Pixels of targets can be hidden by Pair::target_mask, or by an alpha of 0 in an image of the application. On a device the
  /// format must have four channels.
  bool target_masks = false;
  /// References may have a depth image, in which the device chooses the features (DeviceReference::depth).
  bool choose_features = false;

  /// Throws Error(invalid_argument) that names the value.
  void check(const AlignerOptions& options) const;
};

}  // namespace iclk
