#pragma once
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <iclk/align/alignment.h>
#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/options.h>
#include <iclk/align/pyramid.h>

namespace iclk {

/// What a reference image brings. Pointers are read during the call only.
struct Reference {
  ImageView image;          ///< I0
  Camera camera;            ///< of both images of a pair; its size is the plan's
  Features features;        ///< sparse mode
  ImageView inverse_depth;  ///< dense mode: r32f, 1 / metre, 0 or NaN = unknown
};

/// A Gaussian prior on the pose: e = Log(T_10_prior^-1 T_10) ~ N(0, information^-1), twist order [rho, phi].
struct PosePrior {
  SE3 T_10;
  Matrix6d information = Matrix6d::Zero();
};

/// One alignment of a batch: a prepared reference and a target.
struct Pair {
  int reference = 0;  ///< slot given to set_reference
  ImageView target;   ///< I1
  SE3 T_10;           ///< first guess
  std::optional<PosePrior> prior;
  bool search = true;  ///< false: begin at the guess though AlignerOptions::search is enabled
  /// r8, of the target's size: pixels that are 0 are hidden, like those outside the image: what moves by itself, the own
  /// vehicle, the border of an undistorted image. Empty: none. Needs Plan::target_masks.
  ImageView target_mask = {};
};

/// SD-6DoF-ICLK over batches of pairs. One thread at a time.
///
///   xi = (J^T W J + lambda D)^-1 J^T W r,   T_10 <- T_10 Exp(xi)^-1     (paper, eq. 1 to 4)
class Aligner {
 public:
  virtual ~Aligner() = default;

  /// Prepares a keyframe (pyramid, masks, Jacobians) that any number of targets can be aligned against.
  /// Throws Error(invalid_argument) for a slot outside the plan, an image of another size than plan and camera, a bad camera.
  /// Unusable features do not throw: the verdicts come back here and in every Alignment.
  virtual std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) = 0;

  /// One result a pair, in order. Throws Error for bad input (before any work) or a lost device; never for a failed alignment.
  virtual std::vector<Alignment> align(std::span<const Pair> pairs) = 0;

  /// Has the driver compile now what the first align() would wait for. Changes no result.
  virtual void warm_up() {}

  Alignment align(const Pair& pair) { return align(std::span(&pair, 1)).front(); }

  /// What was given for a prepared slot. Precondition: set_reference(slot) succeeded.
  virtual const Camera& camera(int slot) const = 0;
  virtual const Features& features(int slot) const = 0;
  virtual const std::vector<FeatureCheck>& checks(int slot) const = 0;
  virtual const Plan& plan() const = 0;
  /// Luma of the image of a slot that set_reference() prepared, level 0; empty where a device alone has it.
  virtual Map grey(int /*slot*/) const { return {}; }
};

struct Model;

/// The CPU reference: plain C++ and Eigen, one thread, the contract of every other solver. With a model its encoder takes the
/// place of the grey pyramid, with its finest options.levels levels, and its M-estimator gives the weights.
/// Throws Error(invalid_argument): a plan, options or a model that cannot be, more levels than the model has, robust weights
/// beside an M-estimator's.
std::unique_ptr<Aligner> make_cpu_aligner(const Plan& plan, const AlignerOptions& options = {},
                                          std::shared_ptr<const Model> model = nullptr);

}  // namespace iclk
