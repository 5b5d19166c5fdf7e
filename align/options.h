#pragma once
#include <iclk/align/image.h>

namespace iclk {

enum class Solver {
  host,    ///< sums on the device, 6x6 system on the host, one read-back an iteration for the whole batch
  device,  ///< everything in shaders, one submission a batch
  cpu,     ///< the CPU reference: plain C++ and Eigen, no Vulkan
};

/// Weights of the residuals, set once a level from those with which it starts; scale from their median absolute value. unit is
/// the paper's; the others play down what moved by itself or is hidden.
enum class Robust { unit, huber, tukey, cauchy };

enum class Damping {
  fixed,     ///< (H + lambda D) xi = g, every step taken, as in the paper
  adaptive,  ///< Levenberg-Marquardt: a step that raises the cost is taken back, lambda follows the gain ratio
};

/// How to align. Defaults: the classical mode (grey pyramid) with gain and bias, and Huber's weights.
struct AlignerOptions {
  int levels = 4;
  int iterations = 10;   ///< at most, a level
  double lambda = 1e-6;  ///< damping, or its start value
  Damping damping = Damping::fixed;
  Robust robust = Robust::huber;
  bool photometric = true;  ///< estimate gain a and bias b of the pair: r = f1(warp) - (a f0 + b)
  /// Share of what a level has found out about the pose (H / variance of its residuals) that the next finer one keeps as a
  /// prior. 0, the paper: none, the finest level alone decides, however blurred or noisy it is. A prior of the pair
  /// (PosePrior) goes the same way from the coarsest level on, and is weighed against that variance, not residual_sigma.
  double carry = 0;
  /// A level ends early when a step moves no pixel of it by more than this (px of that level). 0: never, as in the paper.
  double step_tolerance = 0.003;
  int min_features = 6;          ///< fewer usable features end in Status::too_few_features
  double min_visible = 0.3;      ///< a smaller share of patch pixels inside the target ends in Status::low_overlap
  double min_correlation = 0.4;  ///< a smaller correlation of f0 and the warped f1 at the end ends in Status::diverged
  /// Correlation of both images' gradients at the end in the pose's worst direction; a smaller one ends in
  /// Status::degenerate: no texture that both images share determines the pose there. On real pairs right poses have 0.1 to
  /// 0.9, wrong ones and edges of one direction in noise at most 0.06.
  double min_agreement = 0.1;
  /// Looks for a start of pairs without a first guess: each feature's patch is looked for in the whole target, in grey values,
  /// with rolls of up to 0.5 rad; poses from three of these correspondences each are scored by all, and the best one is
  /// refined. Where enough agree with it, the pair begins there, at a fine level; where not, at its guess. Sparse mode.
  bool search = false;
  double residual_sigma = 0.02;  ///< standard deviation of a residual, in feature units: the photometric weight beside a prior

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// What an aligner is sized for: its memory is allocated once, for this.
struct Plan {
  int width = 0, height = 0;  ///< of every image
  int max_features = 50;      ///< a reference
  int max_references = 1;     ///< prepared references (keyframes) held at a time
  int max_pairs = 1;          ///< pairs aligned in one batch; larger spans are split
  bool dense = false;         ///< every pixel with depth instead of patches around features
  PixelFormat format =
      PixelFormat::rgba8;  ///< device-side format: r8, rgba8, bgra8, r32f or rgba32f. Host pixels are converted to it.
  /// Pixels of targets can be hidden, by Pair::target_mask or, of an image of the application's, by an alpha of 0. On a device
  /// the format must have four channels.
  bool target_masks = false;
  /// References may come with a depth image, in which the device chooses the features (DeviceReference::depth).
  bool choose_features = false;

  void check(const AlignerOptions& options) const;
};

}  // namespace iclk
