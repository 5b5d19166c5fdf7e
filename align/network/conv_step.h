#pragma once
#include <iclk/align/plan/layout.h>
#include <iclk/align/network/packed_weights.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Of a texel of activations: four channels.
constexpr uint64_t kTexelBytes = 16;
constexpr VkFormat kTexelFormat = VK_FORMAT_R32G32B32A32_SFLOAT;

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
  /// Precondition: can_reduce(). Instead of `out` the step writes `half`, and the map if writes_map(), else channel_sums()
  /// behind `half`.
  bool reduced = false;
  /// Of such a map: MapPlace::whole(), in all tiles.
  bool whole_map = false;
};

/// The step leaves nothing to do for a map.
inline bool writes_map(const ConvStep& step) { return step.reduced && step.variant == ConvVariant::winograd4x1; }

/// What all push constants of convolutions have of a step whose input begins `taps` texels before its first pixel, and whose
/// output is `to`.
template <class Push>
void set_layer(Push& push, const ConvStep& step, uint32_t taps, const TensorLayout& to) {
  push.width = step.out.width;
  push.height = step.out.height;
  push.images = step.out.images;
  push.dilation = step.dilation;
  push.in_offset = step.in.offset() - taps;
  push.in_pitch = step.in.pitch();
  push.in_plane = step.in.plane();
  push.in_image = step.in.image();
  push.in_planes = step.in.planes();
  push.out_offset = to.offset();
  push.out_pitch = to.pitch();
  push.out_plane = to.plane();
  push.out_image = to.image();
  push.out_planes = step.out.planes();
  push.weights = step.packed.weights;
  push.bias = step.packed.bias;
}

/// Workgroups of `lanes` invocations for `count`, spread over y and z behind `x` in x.
engine::Groups spread(uint32_t x, uint64_t count, uint32_t lanes);

}  // namespace iclk::internal
