#pragma once
#include <optional>
#include <vector>

#include <iclk/align/internal/layout.h>
#include <iclk/align/internal/packed_weights.h>
#include <iclk/engine/memory.h>
#include <iclk/engine/recorder.h>
#include <iclk/shaders/network.h>

namespace iclk::internal {

/// Of a texel of activations: four channels.
constexpr uint64_t texel_bytes(Precision precision) { return precision == Precision::fp16 ? 8 : 16; }
constexpr VkFormat texel_format(Precision precision) {
  return precision == Precision::fp16 ? VK_FORMAT_R16G16B16A16_SFLOAT : VK_FORMAT_R32G32B32A32_SFLOAT;
}

/// Where the activations of `images` images lie in a texel buffer: NC4HW4, planes with a border of zeros. All in texels.
struct TensorLayout {
  uint32_t width = 0, height = 0, channels = 0, images = 1, border = 0;

  uint32_t planes() const { return (channels + 3) / 4; }
  uint32_t pitch() const { return width + border; }  // the border right of a row is the one left of the next
  uint32_t plane() const { return pitch() * (height + border); }
  uint32_t image() const { return plane() * planes(); }
  uint32_t offset() const { return border * pitch() + border; }  // of pixel (0, 0) of plane 0
  /// With room for what kernels read beyond, and do not use.
  uint64_t texels() const;
};

/// A convolution that is ready to be recorded.
struct ConvStep {
  ConvVariant variant = ConvVariant::direct;
  TensorLayout in, out;
  uint32_t dilation = 1;
  PackedLayer packed;
  /// Of a level's last layer: the next level's input, 2x2 means of `out`; no pixels where there is no next level.
  TensorLayout half;
  /// Precondition: can_fuse(). One kernel does everything, and its workgroups take their work from a counter.
  bool fused = false;
  /// Of a fused step: its own since the last record_start().
  uint32_t counter = 0;
  /// Precondition: can_reduce(). The step writes `half`, and channel_sums() behind it, instead of `out`.
  bool reduced = false;
};

/// The step's variant, fused or not, can spare writing its output.
bool can_reduce(const ConvStep& step);

/// The device is a CPU with shuffles (see can_shuffle()), the step's variant has a kernel for such, and its limits are kept.
bool can_fuse(const ConvStep& step, const engine::Context& context);

/// What a reduced step leaves for the map: sums over eight channels each, a vec4 for 2x2 pixels. All in vec4.
struct ChannelSums {
  uint32_t offset;  // behind the means
  uint32_t pitch, plane, planes;

  uint32_t image() const { return plane * planes; }
  uint64_t bytes(uint32_t images) const { return 16ull * (offset + static_cast<uint64_t>(image()) * images); }
};
ChannelSums channel_sums(const ConvStep& step, Precision precision);

/// The device's kernels for convolutions of whole maps.
class ConvKernels {
 public:
  /// Uses of the buffers that record() takes; all have texel_format(), weights and scratch that of single precision.
  static constexpr auto kActivations = engine::BufferUse::storage | engine::BufferUse::texel,
                        kWeights = engine::BufferUse::texel | engine::BufferUse::image,
                        kScratch = engine::BufferUse::storage | engine::BufferUse::image;

  /// Those that `steps` need: of each its variant, and whether it is reduced or fused, count. `shuffle`: see can_shuffle(); no
  /// step is fused without. `precision`: of the activations; weights and transformed tiles are single.
  ConvKernels(std::shared_ptr<const engine::Context> context, std::span<const ConvStep> steps, bool shuffle,
              Precision precision);

  /// Scratch texels that a step asks for on a device; 0: none. Not fused: more than one strip of tiles where they are fewer
  /// than a CPU's caches hold, or fill a large device.
  static uint64_t scratch_texels(const ConvStep& step, const engine::Context& context);
  /// The same of a step that is not fused with at most `most` texels, unless that is too few for one strip.
  static uint64_t scratch_texels(const ConvStep& step, engine::DeviceType type, uint64_t most);

  /// Before fused steps: zeroes their counters in `scratch`, ICLK_WORK_COUNTERS of them.
  void record_start(engine::Recorder& recorder, const engine::Buffer& scratch) const;
  /// in -> out. `scratch`: texels for the transformed tiles, as many as scratch_texels() says.
  void record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
              const engine::Buffer& out, const engine::Buffer& scratch) const;
  /// Zeroes the borders in two buffers of what has the same planes, but for their number; record() leaves them as they are.
  /// A layout without channels: nothing is in that buffer.
  void record_borders(engine::Recorder& recorder, const TensorLayout& in_first, const TensorLayout& in_second,
                      const engine::Buffer& first, const engine::Buffer& second) const;
  void add_to(engine::ArenaSize& size) const;

 private:
  void record_columns(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
                      const engine::Buffer& out, const engine::Buffer& scratch) const;
  void record_tiles(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
                    const engine::Buffer& out, const engine::Buffer& scratch) const;

  Precision precision_;
  uint32_t direct_lanes_, product_lanes_;
  engine::Kernel border_, direct_, column_;
  engine::Kernel fused_column_[3];  // whole; reduced; reduced with an even dilation
  struct Winograd {
    engine::Kernel input, product[2], fused[2];  // [1]: reduced
  } winograd_[2];                                // of tiles of 2x2 and 4x4
};

/// Of the SPIR-V that convolutions run.
uint64_t conv_shader_hash();

/// The device hands values between at least eight lanes of a subgroup in compute shaders.
bool can_shuffle(const engine::DeviceInfo& info);

/// Workgroups of `lanes` invocations for `count`, spread over y and z behind `x` in x.
engine::Groups spread(uint32_t x, uint64_t count, uint32_t lanes);

/// Writes to device memory from the host, through a staging buffer of its own where it is not mapped. Blocks.
void write_buffer(const std::shared_ptr<const engine::Context>& context, const engine::Buffer& buffer,
                  std::span<const float> data);

}  // namespace iclk::internal
