#pragma once
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk {

/// All features of one pair, warped by one pose. The slot must not have been set anew since that align().
struct FeatureAlignmentTask {
  int reference = 0;  ///< slot of the aligner
  int pair = 0;       ///< index in the aligner's last align()
  SE3 T_10;
  GreyWeights grey = kLuma;  ///< of the target's colours, if it has any; the same in all tasks of a pair
  bool colours = false;      ///< AlignedFeature::colours is wanted
};

/// Feature alignment over a batch, on the grey maps of the images that an Aligner holds. With a model too: gain, bias,
/// correlation and texture are photometric, and the encoder's maps are not. One thread at a time, and not while the aligner
/// aligns.
class FeatureAligner {
 public:
  virtual ~FeatureAligner() = default;

  /// One list a task, one entry a feature of its reference, in order. Throws Error(invalid_argument) for a slot or a pair that
  /// the aligner does not hold, and for a lost device.
  virtual std::vector<std::vector<AlignedFeature>> align(std::span<const FeatureAlignmentTask> tasks) = 0;

  /// As Aligner's.
  virtual void warm_up() {}

  /// The most pairs of one align() of the aligner whose targets are all still there afterwards.
  virtual int pairs_per_batch() const = 0;
};

/// The feature aligner that works where `aligner` keeps its images; `aligner` must outlive it.
/// Throws Error(unsupported) for an Aligner that is not one of the library's.
std::unique_ptr<FeatureAligner> make_feature_aligner(Aligner& aligner, const FeatureAlignmentOptions& options = {});

}  // namespace iclk
