#pragma once
#include <optional>
#include <vector>

#include <iclk/align/network/conv_step.h>
#include <iclk/align/network/fused_columns.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/shaders/network/network.h>

namespace iclk::internal {

/// Whether the step, fused or not, has a kernel that does not write its output (ConvStep::reduced).
bool can_reduce(const ConvStep& step);

/// Whether the device is a CPU with shuffles (see can_shuffle()), the variant has a fused kernel, and it fits the limits.
bool can_fuse(const ConvStep& step, const engine::Context& context);

/// Whether the device has a kernel for the variant: `winograd4` only if it can be fused, `winograd4x1` only with shuffles.
bool has_kernel(const ConvStep& step, const engine::Context& context);

/// The output of a reduced step for the map: sums over eight channels each, one vec4 for 2x2 pixels. All in vec4.
struct ChannelSums {
  uint32_t offset;  // after the means
  uint32_t pitch, plane, planes;

  uint32_t image() const { return plane * planes; }
  uint64_t texels(uint32_t images) const { return offset + static_cast<uint64_t>(image()) * images; }
};
ChannelSums channel_sums(const ConvStep& step);

/// The device's kernels for convolutions of whole maps.
class ConvKernels {
 public:
  /// Uses of the buffers of record(); all have kTexelFormat.
  static constexpr auto kActivations = engine::BufferUse::storage | engine::BufferUse::texel,
                        kWeights = engine::BufferUse::texel | engine::BufferUse::image,
                        kScratch = engine::BufferUse::storage | engine::BufferUse::image;

  /// Makes the kernels for `steps`: for their variants, and for reduced and fused steps.
  ConvKernels(std::shared_ptr<const engine::Context> context, std::span<const ConvStep> steps);

  /// The number of scratch texels that a step needs.
  static uint64_t scratch_texels(const ConvStep& step);

  /// Must precede fused steps: sets their ICLK_WORK_COUNTERS counters in `scratch` to zero.
  void record_start(engine::Recorder& recorder, const engine::Buffer& scratch) const;
  /// Records a step. `scratch` needs scratch_texels(). A step with writes_map() writes the maps of all images, in their order,
  /// at `place` in one or two `parts`.
  void record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
              const engine::Buffer& out, const engine::Buffer& scratch, const MapPlace& place = {},
              std::span<const MapPart> parts = {}) const;
  /// Sets the borders in two buffers to zero; record() does not change them. Both layouts must have planes of the same size. A
  /// layout without channels: that buffer is unused.
  void record_borders(engine::Recorder& recorder, const TensorLayout& in_first, const TensorLayout& in_second,
                      const engine::Buffer& first, const engine::Buffer& second) const;
  void add_to(engine::ArenaSize& size) const;

 private:
  void record_columns(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
                      const engine::Buffer& out) const;
  void record_tiles(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
                    const engine::Buffer& out, const engine::Buffer& scratch) const;

  /// The number of pixels of a column that an invocation of the direct kernel computes.
  uint32_t direct_rows(const ConvStep& step) const;

  engine::DeviceType type_;
  uint32_t direct_lanes_, column_lanes_;
  engine::Kernel border_, direct_[ICLK_CONV_MOST_ROWS], column_;  // direct_[rows - 1]
  FusedColumns fused_columns_;
  engine::Kernel tiles_[2];  // [1]: reduced
};

/// Whether compute shaders can shuffle values between at least eight lanes of a subgroup.
bool can_shuffle(const engine::DeviceInfo& info);

/// Writes host data to a buffer, through a temporary staging buffer if it is not mapped. Blocks.
void write_buffer(const std::shared_ptr<const engine::Context>& context, const engine::Buffer& buffer,
                  std::span<const float> data);

}  // namespace iclk::internal
