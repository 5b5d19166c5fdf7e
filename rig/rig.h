#pragma once
#include <span>
#include <string>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>
#include <iclk/rig/adjust.h>
#include <iclk/session/session.h>

namespace iclk {

/// What both cameras of a rig saw at one time. Pointers are read during the call only.
struct RigPair {
  ImageView left, right;  ///< undistorted, and both by one pinhole camera: where the right lens differs, remapped to the left's
  Features features;      ///< of the left image
  ImageView right_mask;   ///< r8, 0 where the right image is not to be looked at; may be empty; needs Plan::target_masks
};

struct RigOptions {
  /// Inverse depths of the features are metric, from something that the shock did not touch. False: they only say where to
  /// begin; the images then do not see the scale, and the length of the baseline is kept by a prior.
  bool metric = true;
  double depth_sigma = 0.01;     ///< relative, of inverse depths without a sigma of their own, where they are metric
  double baseline_sigma = 1e-3;  ///< relative, of the baseline's length, where depths are not metric
  bool search = true;            ///< pairs that do not align from the prior are searched (AlignerOptions::search)
  int rounds = 2;                ///< all pairs from the prior, then from the pose on which they agreed
  double max_distance = 30;      ///< normalised squared distance from the common pose at which a pair is an outlier
  /// Standard deviations of the old calibration, for the verdict: rad, and a share of the baseline.
  double calibration_rotation = 3.5e-4, calibration_translation = 1e-3;
  double false_alarm = 1e-3;  ///< probability of "moved" for a rig that has not
  RefinerOptions refiner;
  RigAdjustOptions adjust;  ///< its baseline is set by estimate_rig()

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// One pair of the batch.
struct RigPairReport {
  SE3 T_rl;                                ///< by this pair alone; the start where it has none
  Matrix6d covariance = Matrix6d::Zero();  ///< zero where it has none
  Status status = Status::diverged;
  std::string reason;
  double distance = 0;  ///< squared and normalised, from the common pose
  bool used = false;    ///< in the joint estimate
  int sightings = 0;
  double epipolar_before = 0, epipolar_after = 0;  ///< px, mean of |rectified_error|; of all features found
};

struct RigResult {
  bool usable = false;
  std::string reason;  ///< in words
  SE3 T_rl;            ///< joint: left camera to right camera; the prior unless usable
  Matrix6d covariance = Matrix6d::Zero();
  bool scale_from_prior = false;
  double sigma = 0, inflation = 1;  ///< RigAdjustment
  double epipolar_before = 0, epipolar_after = 0;
  bool moved = false;
  double chi_square = 0,
         threshold = 0;  ///< of the difference from the prior, six degrees of freedom, and what "moved" is beyond
  int pairs_used = 0, sightings = 0, inliers = 0;
  std::vector<RigPairReport> pairs;
  std::vector<RigSighting> found;  ///< of the pairs that were used, with the inverse depths of the end
};

/// What the aligner of a rig has to be made for: all pairs are references and targets; a smaller one takes them in parts.
Plan rig_plan(const Camera& camera, int max_features, int max_pairs, bool masks = false);

/// Each pair by itself from `T_rl`, in batches of the aligner's plan. Uses its slots from 0 on. Throws what Aligner throws.
std::vector<RefinedAlignment> align_pairs(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs,
                                          const SE3& T_rl, const RefinerOptions& options, bool search);
/// The same with an aligner of the session's first model, made for these pairs, SessionOptions::batch at a time.
std::vector<RefinedAlignment> align_pairs(const Session& session, const Camera& camera, std::span<const RigPair> pairs,
                                          const SE3& T_rl, const RefinerOptions& options, bool search);

/// Extrinsics that all pairs share: pairs by themselves, their robust mean by information (the sum of their 6x6 systems, see
/// docs/explain/rig.md), all again from there, then pose and inverse depths together (adjust_rig). `T_rl`: the old
/// calibration.
/// Throws Error(invalid_argument) for no pairs, bad options, a pose that is not finite or without baseline, and what Aligner
/// throws; never for pairs that cannot be aligned.
RigResult estimate_rig(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl,
                       const RigOptions& options = {});
/// The same with an aligner of the session's first model, made for these pairs, SessionOptions::batch at a time.
RigResult estimate_rig(const Session& session, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl,
                       const RigOptions& options = {});

/// x with P(chi^2 of `freedom` degrees <= x) = 1 - p (Wilson and Hilferty 1931: within 1 % for p of 0.1 to 1e-6).
double chi_square_quantile(int freedom, double p);

}  // namespace iclk
