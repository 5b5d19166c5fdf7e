#pragma once
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/refine/internal/recolour.h>

namespace iclk {
class CpuAligner;
class DeviceAligner;
}  // namespace iclk

namespace iclk::internal {

/// All features of one pair, warped by one pose. The slot must not have been set anew since that align().
struct FeatureAlignmentTask {
  int reference = 0;  ///< slot of the aligner
  int pair = 0;       ///< index in the aligner's last align()
  SE3 T_10;
  GreyWeights grey = kLuma;  ///< of the target's colours, if it has any; the same in all tasks of a pair
  bool colours = false;      ///< AlignedFeatures::colours is wanted
};

/// Throws Error(invalid_argument) for a slot or a pair outside a plan of so many.
void check(const FeatureAlignmentTask& task, int references, int pairs);

struct AlignedFeatures {
  std::vector<AlignedFeature> features;  ///< one a feature of the task's reference, in order
  /// One a feature, where the task asks and the target has colours, else empty. All zero unless aligned.
  std::vector<ColourSums> colours;
};

/// Feature alignment over a batch, on the grey maps of the images that an Aligner holds. With a model too: gain, bias,
/// correlation and texture are photometric, and the encoder's maps are not. One thread at a time, and not while the aligner
/// aligns.
class FeatureAligner {
 public:
  virtual ~FeatureAligner() = default;

  /// One result a task, in order. Throws Error(invalid_argument) for a slot or a pair that the aligner does not hold, and for a
  /// lost device.
  virtual std::vector<AlignedFeatures> align(std::span<const FeatureAlignmentTask> tasks) = 0;

  /// As Aligner's.
  virtual void warm_up() {}

  /// The most pairs of one align() of the aligner whose targets are all still there afterwards.
  virtual int pairs_per_batch() const = 0;
};

/// The CPU reference: align_feature() for every feature.
std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(const CpuAligner& aligner,
                                                         const FeatureAlignmentOptions& options = {});

/// shaders/refine/feature_alignment.comp on the grey maps of a DeviceAligner, one submission a call; the same contract, single
/// precision. `aligner` must outlive it. Memory is allocated here, for the aligner's plan; with a model also that of the grey
/// maps (internal::GreyMaps). Throws Error(unsupported) if it does not fit.
std::unique_ptr<FeatureAligner> make_device_feature_aligner(const DeviceAligner& aligner,
                                                            const FeatureAlignmentOptions& options = {});

/// The feature aligner that works where `aligner` keeps its images; `aligner` must outlive it.
/// Throws Error(unsupported) for an Aligner that is not one of the library's.
std::unique_ptr<FeatureAligner> make_feature_aligner(Aligner& aligner, const FeatureAlignmentOptions& options = {});

}  // namespace iclk::internal
