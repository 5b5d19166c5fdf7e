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

/// All features of one pair, warped by one pose. Precondition: the slot has not been set again since that align().
struct FeatureAlignmentTask {
  int reference = 0;  ///< slot of the aligner
  int pair = 0;       ///< index in the aligner's last align()
  SE3 T_10;
  GreyWeights grey = kLuma;  ///< for the colours of the target, if it has any; equal in all tasks of a pair
  bool colours = false;      ///< compute AlignedFeatures::colours; with level 0 only
  int level = 0;             ///< of the grey pyramid, on which positions are found; without that level, none are
};

/// Throws Error(invalid_argument) for a slot or a pair outside a plan with these sizes, and for a level that is not one of the
/// kFeatureAlignmentLevels finest.
void check(const FeatureAlignmentTask& task, int references, int pairs);

struct AlignedFeatures {
  std::vector<AlignedFeature> features;  ///< one per feature of the task's reference, in order
  /// One per feature if the task requests them and the target has colours, else empty. Zero unless aligned.
  std::vector<ColourSums> colours;
};

/// Feature alignment over a batch, on the grey maps of an Aligner's images. It uses grey maps with a model too, because gain,
/// bias, correlation and texture are photometric. One thread at a time, and not while the aligner runs.
class FeatureAligner {
 public:
  virtual ~FeatureAligner() = default;

  /// Returns one result per task, in order. Throws Error(invalid_argument) for a slot or pair that the aligner does not have;
  /// Error(device_lost).
  virtual std::vector<AlignedFeatures> align(std::span<const FeatureAlignmentTask> tasks) = 0;

  /// See Aligner::warm_up().
  virtual void warm_up() {}

  /// The largest number of pairs of one align() whose targets the aligner still has afterwards.
  virtual int pairs_per_batch() const = 0;
};

/// The CPU reference: align_feature() for every feature.
std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(const CpuAligner& aligner,
                                                         const FeatureAlignmentOptions& options = {});

/// shaders/refine/feature_alignment.comp on the grey maps of a DeviceAligner, in single precision, with one submission per
/// call. `aligner` must outlive it. This call allocates the memory for the aligner's plan, with a model also the grey maps
/// (internal::GreyMaps). Throws Error(unsupported) if it does not fit.
std::unique_ptr<FeatureAligner> make_device_feature_aligner(const DeviceAligner& aligner,
                                                            const FeatureAlignmentOptions& options = {});

/// Makes the feature aligner for the type of `aligner`, which must outlive it. Throws Error(unsupported) for an Aligner that is
/// not from this library.
std::unique_ptr<FeatureAligner> make_feature_aligner(Aligner& aligner, const FeatureAlignmentOptions& options = {});

}  // namespace iclk::internal
