#pragma once
#include <span>
#include <string>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>
#include <iclk/rig/adjust.h>
#include <iclk/session/session.h>

namespace iclk {

/// The images of both cameras of a rig at one time. Pointers are read during the call only.
struct RigPair {
  ImageView left, right;  ///< undistorted, to the same pinhole camera: remap the right image to the left camera
  Features features;      ///< of the left image
  ImageView right_mask;   ///< r8; pixels of the right image that are 0 are ignored; may be empty; needs Plan::target_masks
};

struct RigOptions {
  /// true: the features' inverse depths are metric, from a source that the shock did not affect. false: they are only first
  /// guesses. The images then do not determine the scale, and a prior keeps the length of the baseline.
  bool metric = true;
  double depth_sigma = 0.01;     ///< relative, of metric inverse depths without a sigma
  double baseline_sigma = 1e-3;  ///< relative, of the baseline's length, if depths are not metric
  bool search = true;            ///< search for pairs that do not align from the prior (AlignerOptions::search)
  int rounds = 2;                ///< the first starts all pairs from the prior, later ones from the common pose
  double max_distance = 30;      ///< pairs with a larger normalised squared distance from the common pose are outliers
  /// Standard deviations of the old calibration, for the verdict: rad, and a share of the baseline.
  double calibration_rotation = 3.5e-4, calibration_translation = 1e-3;
  double false_alarm = 1e-3;  ///< the probability of "moved" for a rig that has not moved
  RefinerOptions refiner;
  RigAdjustOptions adjust;  ///< estimate_rig() sets its baseline

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// One pair of the batch.
struct RigPairReport {
  SE3 T_rl;                                ///< from this pair alone; the start if it gave no pose
  Matrix6d covariance = Matrix6d::Zero();  ///< zero if it gave no pose
  Status status = Status::diverged;
  std::string reason;
  double distance = 0;  ///< normalised squared distance from the common pose
  bool used = false;    ///< in the joint estimate
  int sightings = 0;
  double epipolar_before = 0, epipolar_after = 0;  ///< px, mean of |rectified_error()| over all features found
};

struct RigResult {
  bool usable = false;
  std::string reason;  ///< explains `usable`
  SE3 T_rl;            ///< the joint estimate, left camera to right camera; the prior unless usable
  Matrix6d covariance = Matrix6d::Zero();
  bool scale_from_prior = false;
  double sigma = 0, inflation = 1;                 ///< see RigAdjustment
  double epipolar_before = 0, epipolar_after = 0;  ///< px, mean of |rectified_error()|
  bool moved = false;
  /// chi^2 of the difference from the prior, with six degrees of freedom; `moved` is true if it exceeds the threshold.
  double chi_square = 0, threshold = 0;
  int pairs_used = 0, sightings = 0, inliers = 0;
  std::vector<RigPairReport> pairs;
  std::vector<RigSighting> found;  ///< of the used pairs, with the final inverse depths
};

/// The plan for the aligner of a rig: all pairs at once. An aligner with a smaller plan aligns them in parts.
Plan rig_plan(const Camera& camera, int max_features, int max_pairs, bool masks = false);

/// Aligns each pair separately, starting from `T_rl`, in batches of the aligner's plan. Overwrites its slots from 0 on. Throws
/// the errors of Aligner.
std::vector<RefinedAlignment> align_pairs(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs,
                                          const SE3& T_rl, const RefinerOptions& options, bool search);
/// The same, with a new aligner of the session's first model for batches of SessionOptions::batch pairs.
std::vector<RefinedAlignment> align_pairs(const Session& session, const Camera& camera, std::span<const RigPair> pairs,
                                          const SE3& T_rl, const RefinerOptions& options, bool search);

/// Estimates the extrinsics that all pairs share; `T_rl` is the old calibration. Each pair is aligned separately. The robust
/// mean of the pairs, weighted by information, gives a common pose (the sum of their 6x6 systems: docs/explain/rig.md). All
/// pairs are aligned again from there, and adjust_rig() then adjusts the pose and all inverse depths together.
/// Throws Error(invalid_argument) without pairs, for bad options, and for a pose that is not finite or has no baseline; also
/// the errors of Aligner, but never for pairs that cannot be aligned.
RigResult estimate_rig(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl,
                       const RigOptions& options = {});
/// The same, with a new aligner of the session's first model for batches of SessionOptions::batch pairs.
RigResult estimate_rig(const Session& session, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl,
                       const RigOptions& options = {});

/// The x with P(chi^2 <= x) = 1 - p for `freedom` degrees of freedom (Wilson and Hilferty 1931: within 1 % for p of 0.1 to
/// 1e-6).
double chi_square_quantile(int freedom, double p);

}  // namespace iclk
