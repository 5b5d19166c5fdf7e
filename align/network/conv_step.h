#pragma once
#include <iclk/align/network/packed_weights.h>
#include <iclk/align/plan/layout.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// The size of a texel of activations, which has four channels.
constexpr uint64_t kTexelBytes = 16;
constexpr VkFormat kTexelFormat = VK_FORMAT_R32G32B32A32_SFLOAT;

/// The layout of the activations of `images` images in a texel buffer: NC4HW4, planes with a border of zeros. All in texels.
struct TensorLayout {
  uint32_t width = 0, height = 0, channels = 0, images = 1, border = 0;

  uint32_t planes() const { return (channels + 3) / 4; }
  uint32_t pitch() const { return width + border; }  // the border right of a row is also the one left of the next row
  uint32_t plane() const { return pitch() * (height + border); }
  uint32_t image() const { return plane() * planes(); }
  uint32_t offset() const { return border * pitch() + border; }  // of pixel (0, 0) of plane 0
  /// The size of the buffer, including texels that kernels read beyond the end but do not use.
  uint64_t texels() const;
};

/// A convolution, ready to be recorded.
struct ConvStep {
  ConvVariant variant = ConvVariant::direct;
  TensorLayout in, out;
  uint32_t dilation = 1;
  PackedLayer packed;
  /// For the last layer of a level: the input of the next level, 2x2 means of `out`. Without pixels if there is no next level.
  TensorLayout half;
  /// One kernel does the whole step; its workgroups take their work from a counter. Precondition: can_fuse().
  bool fused = false;
  /// For a fused step: the index of its counter, different for all steps since the last record_start().
  uint32_t counter = 0;
  /// Instead of `out` the step writes `half` and the map; unless writes_map(), it writes channel_sums() after `half` instead of
  /// the map. Precondition: can_reduce().
  bool reduced = false;
  /// For a step that writes the map: MapPlace::whole() is true in all tiles.
  bool whole_map = false;
};

/// Whether the step itself writes the complete map.
inline bool writes_map(const ConvStep& step) { return step.reduced && step.variant == ConvVariant::winograd4x1; }

/// Sets the push constants that all convolutions share. The input begins `taps` texels before its first pixel; the output goes
/// to `to`.
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

/// Workgroups of `lanes` invocations for `count` invocations, in y and z, with `x` workgroups in x.
engine::Groups spread(uint32_t x, uint64_t count, uint32_t lanes);

}  // namespace iclk::internal
