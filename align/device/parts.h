#pragma once
// Parts of a DeviceAligner, for feature alignment, which uses the same images, and for tests.
#include <memory>
#include <span>

#include <iclk/align/device/device_matching.h>
#include <iclk/align/device_aligner.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

/// Maps on the device as texel views. Level 0 of slot or pair i begins at texel i * fine_stride of fine0 or fine1. Other levels
/// begin at i * map_stride + LevelInfo::map_offset of maps0 or maps1. Level 0 of grey maps is the raw pixels if Plan::format
/// has one channel, else it is in the maps. Targets are those of the last batch.
struct DeviceMaps {
  const engine::Buffer* levels;         ///< shaders::LevelInfo
  const engine::Buffer* references;     ///< one shaders::ReferenceInfo per slot
  const engine::Buffer *fine0, *fine1;  ///< r8, r32f
  const engine::Buffer *maps0, *maps1;  ///< r32f
  uint32_t fine_stride, map_stride;
  const engine::Buffer* pixels1;  ///< raw pixels of the targets, Plan::format, rows of levels[0].pitch
  uint32_t pixel_stride;          ///< 32-bit words from one target to the next
  uint32_t pixel_format;          ///< an ICLK_FORMAT_... constant of iclk/shaders/shared.h
};

struct GreyTarget {
  int pair;
  GreyWeights weights = kLuma;
};

/// The grey maps of the images, for feature alignment. Without a model they are those of the alignment, except for targets with
/// weights other than luma. All other maps are made from the aligner's pixels: the kFeatureAlignmentLevels finest levels, at
/// most AlignerOptions::levels. They have separate memory, so aligners without refinement do not need it.
///
/// The maps of a slot are made once for all targets, those of a pair once for each batch and each set of weights. After
/// DeviceAligner::record() they are made at every call, because executions are not counted. The aligner must outlive this.
class GreyMaps {
 public:
  virtual ~GreyMaps() = default;
  /// Records updates of the maps of these slots and targets, and returns the maps. Duplicates cost nothing; if a pair occurs
  /// twice, the last one counts. Precondition: all are within the plan and the batch.
  virtual DeviceMaps record(engine::Recorder& recorder, std::span<const int> slots, std::span<const GreyTarget> targets) = 0;
  /// Call it after the commands of record() have executed; else the next record() repeats them.
  virtual void executed() = 0;
  /// Adds the descriptors that record() needs.
  virtual void add_to(engine::ArenaSize& size) const = 0;
};

struct DeviceParts {
  /// The maps of the alignment: the grey pyramid, or with a model those of its encoder.
  static DeviceMaps maps(const DeviceAligner& aligner);
  /// Allocates all memory. `recolour`: weights other than luma will be used. Without a model and with grey images nothing is
  /// allocated. Throws Error(unsupported) if it does not fit the device.
  static std::unique_ptr<GreyMaps> make_grey_maps(const DeviceAligner& aligner, bool recolour = true);
  /// The number of features that the device chooses in this slot; 0 if the host has set them.
  static uint32_t chosen_features(const DeviceAligner& aligner, int slot);
  /// The search by matching, which is false if the plan has none.
  static const DeviceMatching& matching(const DeviceAligner& aligner);
  /// The memory of the search.
  static const engine::Workspace& memory(const DeviceAligner& aligner);
  /// The template of all slots: (u, v, inverse depth, f0) and (gu, gv, -, -) per element; shaders/align/jacobian.comp.
  static const engine::Buffer& template_pixels(const DeviceAligner& aligner);
  static const engine::Buffer& template_gradients(const DeviceAligner& aligner);
};

}  // namespace iclk::internal
