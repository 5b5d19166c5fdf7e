#pragma once
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk {

class CpuAligner;
class DeviceAligner;

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

/// Grey maps (level 0, and level 1 if there is one; more are not read), colours and features on the host: what the CPU feature
/// aligner reads. Pairs count within the last batch. Every function throws Error(invalid_argument) for a slot or a pair that is
/// not there.
class FeatureMaps {
 public:
  virtual ~FeatureMaps() = default;
  virtual const Pyramid& reference_grey(int slot) const = 0;
  virtual const Pyramid& target_grey(int pair) const = 0;
  /// Level 0 as rgb_maps() makes it; empty: no colours.
  virtual std::span<const Map> target_rgb(int pair) const = 0;
  virtual const Camera& camera(int slot) const = 0;
  virtual const Features& features(int slot) const = 0;
  virtual const std::vector<FeatureCheck>& checks(int slot) const = 0;
  virtual int pairs_per_batch() const = 0;
};

/// The CPU reference: align_feature() for every feature.
std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(std::unique_ptr<FeatureMaps> maps,
                                                         const FeatureAlignmentOptions& options = {});
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

}  // namespace iclk
