#pragma once
#include <optional>
#include <vector>

#include <iclk/align/network/conv_step.h>
#include <iclk/align/network/fused_columns.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/shaders/network/network.h>

namespace iclk::internal {

/// The step, fused or not, can spare writing its output.
bool can_reduce(const ConvStep& step);

/// The device is a CPU with shuffles (see can_shuffle()), the step's variant has a kernel for such, and its limits are kept.
bool can_fuse(const ConvStep& step, const engine::Context& context);

/// The device has a kernel for the step's variant: `winograd4` only where it can be fused, `winograd4x1` with shuffles.
bool has_kernel(const ConvStep& step, const engine::Context& context);

/// What a reduced step leaves for the map: sums over eight channels each, a vec4 for 2x2 pixels. All in vec4.
struct ChannelSums {
  uint32_t offset;  // behind the means
  uint32_t pitch, plane, planes;

  uint32_t image() const { return plane * planes; }
  uint64_t texels(uint32_t images) const { return offset + static_cast<uint64_t>(image()) * images; }
};
ChannelSums channel_sums(const ConvStep& step);

/// The device's kernels for convolutions of whole maps.
class ConvKernels {
 public:
  /// Uses of the buffers that record() takes; all have kTexelFormat.
  static constexpr auto kActivations = engine::BufferUse::storage | engine::BufferUse::texel,
                        kWeights = engine::BufferUse::texel | engine::BufferUse::image,
                        kScratch = engine::BufferUse::storage | engine::BufferUse::image;

  /// Those that `steps` need: of each its variant, and whether it is reduced or fused, count.
  ConvKernels(std::shared_ptr<const engine::Context> context, std::span<const ConvStep> steps);

  /// Scratch texels that a step asks for; 0: none.
  static uint64_t scratch_texels(const ConvStep& step);

  /// Before fused steps: zeroes their counters in `scratch`, ICLK_WORK_COUNTERS of them.
  void record_start(engine::Recorder& recorder, const engine::Buffer& scratch) const;
  /// in -> out. `scratch`: as many texels as scratch_texels() says. A step that writes_map() does so
  /// at `place`, of all images in their order in one or two `parts`.
  void record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
              const engine::Buffer& out, const engine::Buffer& scratch, const MapPlace& place = {},
              std::span<const MapPart> parts = {}) const;
  /// Zeroes the borders in two buffers of what has the same planes, but for their number; record() leaves them as they are.
  /// A layout without channels: nothing is in that buffer.
  void record_borders(engine::Recorder& recorder, const TensorLayout& in_first, const TensorLayout& in_second,
                      const engine::Buffer& first, const engine::Buffer& second) const;
  void add_to(engine::ArenaSize& size) const;

 private:
  void record_columns(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
                      const engine::Buffer& out) const;
  void record_tiles(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
                    const engine::Buffer& out, const engine::Buffer& scratch) const;

  /// Pixels of a column that an invocation of the direct kernel makes.
  uint32_t direct_rows(const ConvStep& step) const;

  engine::DeviceType type_;
  uint32_t direct_lanes_, column_lanes_;
  engine::Kernel border_, direct_[ICLK_CONV_MOST_ROWS], column_;  // direct_[rows - 1]
  FusedColumns fused_columns_;
  engine::Kernel tiles_[2];  // [1]: reduced
};

/// The device hands values between at least eight lanes of a subgroup in compute shaders.
bool can_shuffle(const engine::DeviceInfo& info);

/// Writes to device memory from the host, through a staging buffer of its own where it is not mapped. Blocks.
void write_buffer(const std::shared_ptr<const engine::Context>& context, const engine::Buffer& buffer,
                  std::span<const float> data);

}  // namespace iclk::internal
