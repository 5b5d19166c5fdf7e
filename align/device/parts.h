#pragma once
// What lies inside a DeviceAligner, for feature alignment, which works on the same images, and for tests.
#include <memory>
#include <span>

#include <iclk/align/device_aligner.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/device/device_matching.h>

namespace iclk::internal {

/// Maps on the device as texel views. Level 0 of slot or pair i begins at texel i * fine_stride of fine0 or fine1, levels
/// beyond at i * map_stride + LevelInfo::map_offset of maps0 or maps1. Level 0 of grey maps of a single-channel Plan::format
/// is the pixels themselves, else it lies in the maps. Targets are those of the last batch.
struct DeviceMaps {
  const engine::Buffer* levels;         ///< shaders::LevelInfo
  const engine::Buffer* references;     ///< shaders::ReferenceInfo a slot
  const engine::Buffer *fine0, *fine1;  ///< r8, r32f
  const engine::Buffer *maps0, *maps1;  ///< r32f
  uint32_t fine_stride, map_stride;
  const engine::Buffer* pixels1;  ///< raw pixels of the targets, Plan::format, rows of levels[0].pitch
  uint32_t pixel_stride;          ///< 32-bit words from a target's to the next
  uint32_t pixel_format;          ///< ICLK_FORMAT_* of iclk/shaders/shared.h
};

struct GreyTarget {
  int pair;
  GreyWeights weights = kLuma;
};

/// The images' grey maps, for feature alignment, which is photometric. Without a model they are those of the alignment, and
/// targets with other weights than luma's are made from the aligner's pixels; with a model all are: the
/// kFeatureAlignmentLevels finest levels as far as AlignerOptions::levels goes, in memory of their own, so that who does not
/// refine does not pay for them. Those of a slot are made once for all targets, of a pair once a batch and weights; after
/// record(), whose executions nobody counts, at every call. The aligner must outlive it.
class GreyMaps {
 public:
  virtual ~GreyMaps() = default;
  /// Records what brings the maps of these slots and targets up to date, and returns where they are. Duplicates cost nothing;
  /// of a pair the last one counts. Precondition: all are within the plan and the batch.
  virtual DeviceMaps record(engine::Recorder& recorder, std::span<const int> slots, std::span<const GreyTarget> targets) = 0;
  /// After what record() wrote was executed; without this the next record() writes it again.
  virtual void executed() = 0;
  /// Room that record() takes in a descriptor arena.
  virtual void add_to(engine::ArenaSize& size) const = 0;
};

struct DeviceParts {
  /// What the alignment works on: the grey pyramid, or with a model what its encoder made.
  static DeviceMaps maps(const DeviceAligner& aligner);
  /// Allocates everything. Throws Error(unsupported) if it does not fit the device.
  /// `recolour`: weights other than luma's will come; without a model and without colours nothing is allocated either way.
  static std::unique_ptr<GreyMaps> make_grey_maps(const DeviceAligner& aligner, bool recolour = true);
  /// Features that the device chooses in this slot; 0 where the host has given them.
  static uint32_t chosen_features(const DeviceAligner& aligner, int slot);
  /// The search by matching, which is false where the plan has none; and the memory that it works on.
  static const DeviceMatching& matching(const DeviceAligner& aligner);
  static const engine::Workspace& memory(const DeviceAligner& aligner);
  /// Template of all slots: (u, v, inverse depth, f0) and (gu, gv, -, -) an element; shaders/align/jacobian.comp.
  static const engine::Buffer& template_pixels(const DeviceAligner& aligner);
  static const engine::Buffer& template_gradients(const DeviceAligner& aligner);
};

}  // namespace iclk::internal
