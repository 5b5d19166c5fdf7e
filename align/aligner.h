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

/// A reference image with its camera and depths. Pointers are read during the call only.
struct Reference {
  ImageView image;          ///< I0
  Camera camera;            ///< of both images of a pair; its size must be that of the plan
  Features features;        ///< for sparse mode
  ImageView inverse_depth;  ///< for dense mode: r32f, 1 / metre, 0 or NaN: unknown
};

/// A Gaussian prior on the pose: e = Log(T_10_prior^-1 T_10) ~ N(0, information^-1), twist order [rho, phi].
struct PosePrior {
  SE3 T_10;
  Matrix6d information = Matrix6d::Zero();
};

/// One alignment of a batch: a prepared reference and a target.
struct Pair {
  int reference = 0;  ///< the slot passed to set_reference()
  ImageView target;   ///< I1
  SE3 T_10;           ///< the first guess
  std::optional<PosePrior> prior;
  bool search = true;  ///< false: begin at the first guess even if AlignerOptions::search is on
  /// r8, of the size of the target. Pixels that are 0 are hidden, like pixels outside the image: use it for moving objects,
  /// the own vehicle, or the border of an undistorted image. Empty: nothing is hidden. Needs Plan::target_masks.
  ImageView target_mask = {};
  /// With `search`: T_10 is a start that was found already. The pair begins there, at the level of the search, and does not
  /// search again. Its answer is questioned like that of any search.
  bool found = false;
};

/// Aligns batches of pairs with SD-6DoF-ICLK. One thread at a time.
///
///   xi = (J^T W J + lambda D)^-1 J^T W r,   T_10 <- T_10 Exp(xi)^-1     (paper, eq. 1 to 4)
class Aligner {
 public:
  virtual ~Aligner() = default;

  /// Prepares a keyframe (pyramid, masks, Jacobians) that any number of targets can be aligned to. Returns one verdict per
  /// feature; unusable features do not throw. Throws Error(invalid_argument) for a slot outside the plan, an image whose size
  /// differs from plan or camera, and a bad camera.
  virtual std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) = 0;

  /// Returns one result per pair, in order. Throws Error for bad input (before any work) and for a lost device, but never for
  /// a failed alignment.
  virtual std::vector<Alignment> align(std::span<const Pair> pairs) = 0;

  /// Compiles the kernels now, so that the first align() does not wait for the driver. Changes no result.
  virtual void warm_up() {}

  Alignment align(const Pair& pair) { return align(std::span(&pair, 1)).front(); }

  /// The input of a prepared slot. Precondition: set_reference(slot) succeeded.
  virtual const Camera& camera(int slot) const = 0;
  virtual const Features& features(int slot) const = 0;
  virtual const std::vector<FeatureCheck>& checks(int slot) const = 0;
  virtual const Plan& plan() const = 0;
  /// The luma of a prepared reference image at level 0; empty if only the device has it.
  virtual Map grey(int /*slot*/) const { return {}; }
};

struct Model;

/// Makes the CPU reference, whose results define those of every other solver: plain C++ and Eigen, one thread. With a model,
/// the `options.levels` finest levels of its encoder replace the grey pyramid, and its M-estimator gives the weights.
/// Throws Error(invalid_argument) for an invalid plan, options or model, for more levels than the model has, and for robust
/// weights together with an M-estimator.
std::unique_ptr<Aligner> make_cpu_aligner(const Plan& plan, const AlignerOptions& options = {},
                                          std::shared_ptr<const Model> model = nullptr);

}  // namespace iclk
