// Constants and push constants of the network's shaders, declared once for GLSL and C++. Activations are texels of four
// channels (a "plane"), plane after plane, image after image. All offsets and strides are in texels.
#ifndef ICLK_SHADERS_NETWORK_H
#define ICLK_SHADERS_NETWORK_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

// Output channels per invocation: eight lanes load and share eight texels of weights (4 input x 8 output channels).
#define ICLK_CONV_CHANNELS 8
// Rows per invocation of conv_direct, `dilation` apart, and the largest such number (for whole maps on large GPUs).
#define ICLK_CONV_ROWS 4
#define ICLK_CONV_MOST_ROWS 8
// Tiles of four rows per invocation of winograd4x1.
#define ICLK_COLUMN_TILES 2
// Tiles per invocation of Winograd's products.
#define ICLK_WINOGRAD_TILES 4

// winograd_fused: slots for transformed tiles, as many as lavapipe has threads at most (LP_MAX_THREADS). Before them in the
// scratch memory is one word per counter of work items and per slot, each on its own cache line.
#define ICLK_FUSED_SLOTS 32
#define ICLK_WORK_COUNTERS 64
#define ICLK_WORK_WORDS 16
#define ICLK_FUSED_WORK_TEXELS ((ICLK_WORK_COUNTERS + ICLK_FUSED_SLOTS) * ICLK_WORK_WORDS / 4)

// F(4x4, 3x3) interpolates at 0, +-A, +-B and infinity. With the usual values 1 and 2, rounding errors are three to eight times
// as large. With these they are below twice those of the direct convolution.
#define ICLK_WINOGRAD_A 0.70710678
#define ICLK_WINOGRAD_B 1.41421356

// Strips of rows for which image_moments.comp computes mean and deviation.
#define ICLK_LIGHT_STRIPS 32
// The least deviation for Normalisation::image, 1 / 255 of the range. Less is rounding, not texture.
#define ICLK_LEAST_DEVIATION 0.003921569

// Pixels of an image that are larger or not finite are left out of its mean and deviation.
#define ICLK_LARGEST_PIXEL 1e15

struct MomentsPush {
  uint width, height;
  uint row_pixels, pixel_stride, first_image, at;  // as in NormalisePush
};

struct NormalisePush {
  uint width, height;
  uint origin;        // the first pixel of the image, or of a tile of it
  uint row_pixels;    // of the raw pixels
  uint pixel_stride;  // 32-bit words from one image to the next
  uint first_image;   // in the pixels
  uint at;            // its index in the pass
  uint out_offset, out_pitch, out_image;
  float mean[3], inverse_std[3];
};

// Writes the zeros right of the rows and below the planes. They are also the zeros left of the next row and above the next
// plane.
struct BorderPush {
  uint height;  // of a plane without its border
  uint offset, pitch, plane;
  uint width;      // of the border
  uint planes[2];  // in each buffer; 0: the buffer is unused
};

struct ConvPush {
  uint width, height, images;  // of the output
  uint dilation;
  uint in_offset;  // of the top left tap of the first pixel
  uint in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image, out_planes;
  uint weights, bias;  // in the network's weights
  // For patches: an image is a patch of a level; pixels outside the level are zero.
  uint margin;  // distance from the first pixel of the output to that of the patch
  uint level_width, level_height;
};

// winograd4x1_fused: 124 of the 128 bytes that every device has.
struct ColumnPush {
  // As in ConvPush; for a reduced layer, out_* are those of the 2x2 means.
  uint width, height, images, dilation;
  uint in_offset, in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image, out_planes;
  uint weights, bias;
  // The size of a work item in workgroup widths and blocks of output channels; the index of the counter.
  uint item_steps, item_blocks, counter;
  uint halves;  // 0: no means
  // The map of a reduced layer, as in FeatureMapPush; from image `split` on, maps are in the second buffer.
  uint map_offset, map_pitch, map_stride, first_u, first_v, end_u, end_v;
  uint first_image[2], split;
  float inverse_channels;
};

struct WinogradPush {
  uint width, height, images;  // of input and output
  uint dilation;
  uint in_offset, in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image, out_planes;
  uint weights, bias;
  uint tiles_x, tiles_y;  // of one of the dilation^2 interleaved sub-grids
  uint tiles;
  uint lane_bits;  // binary logarithm of the lanes of a workgroup, see winograd_tile.glsl
  // Blocks of output channels of a work item; the index of the counter.
  uint item_blocks, counter;
  // For a reduced layer, out_* are those of the 2x2 means.
  uint halves;  // 0: no means
  uint sums;    // texels of single precision before the sums over channels
};

// Writes means over the channels to the maps, and 2x2 means to the input of the next level. For a reduced layer, only the maps
// are written; the input is then sums over eight channels each, one texel for 2x2 pixels.
struct FeatureMapPush {
  uint width, height;
  uint in_offset, in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image;
  uint map_offset, map_pitch, map_stride, first_image;
  uint first_u, first_v, end_u, end_v;  // the pixels of the tile that are written; the tile's first pixel is at map_offset
  float inverse_channels;
  uint halves;  // 0: no next level
};

// The convolutional M-estimator of a level, at the residual with which it starts.
struct MEstimatorPush {
  // As in IteratePush:
  uint level, element_stride, map_stride, weight_stride, flags;
  uint max_features;
  uint first_pair;     // of this pass
  uint inputs_stride;  // texels from the input of one pair to the next
  uint prior_stride;   // floats from the weight maps of one pair to the next
  uint prior_origin;   // LevelInfo::map_offset of the first level in the weight maps
  uint coarsest;       // 1: there is no coarser level; its weight is 1
  // Patches: patch i of the pass is patch i % patches_per_pair of pair first_pair + i / patches_per_pair.
  uint first_patch, patches, patches_per_pair;
  uint margin;  // of the network's receptive field around a patch
  uint dense;   // 1: patches are 8x8 blocks of the level
  uint whole;   // 1: the network processes the whole level, not patches
};

#ifdef __cplusplus
}  // namespace iclk::shaders
#endif
#endif
