// Constants and push constants of the convolutional network's shaders, declared once for GLSL and C++. Activations are texels
// of four channels ("planes"), a plane after the other, an image after the other; all numbers of the places are texels.
#ifndef ICLK_SHADERS_NETWORK_H
#define ICLK_SHADERS_NETWORK_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

// Output channels that an invocation makes: eight texels of weights (4 input x 8 output channels) are what eight lanes load
// and share.
#define ICLK_CONV_CHANNELS 8
// Rows that an invocation of conv_direct makes, `dilation` apart; the most, of whole maps on large GPUs.
#define ICLK_CONV_ROWS 4
#define ICLK_CONV_MOST_ROWS 8
// Tiles of four rows that an invocation of winograd4x1 makes.
#define ICLK_COLUMN_TILES 2
// Tiles that an invocation of Winograd's products makes.
#define ICLK_WINOGRAD_TILES 4

// winograd_fused: slots for transformed tiles, as many as lavapipe has threads at most (LP_MAX_THREADS). Before them in the
// scratch memory one word each for the items of work that a dispatch has taken and for each slot, on cache lines of their own.
#define ICLK_FUSED_SLOTS 32
#define ICLK_WORK_COUNTERS 64
#define ICLK_WORK_WORDS 16
#define ICLK_FUSED_WORK_TEXELS ((ICLK_WORK_COUNTERS + ICLK_FUSED_SLOTS) * ICLK_WORK_WORDS / 4)

// F(4x4, 3x3) interpolates at 0, +-A, +-B and infinity. With 1 and 2, which most use, rounding errors
// are three to eight times as large; with these they are below twice those of the direct convolution.
#define ICLK_WINOGRAD_A 0.70710678
#define ICLK_WINOGRAD_B 1.41421356

// Strips of rows of which image_moments.comp finds mean and deviation.
#define ICLK_LIGHT_STRIPS 32
// Of an image that is normalised by itself, 1 / 255 of the range: less is no texture but rounding.
#define ICLK_LEAST_DEVIATION 0.003921569

// Larger pixels of an image, and those that are not finite, do not count for its light.
#define ICLK_LARGEST_PIXEL 1e15

struct MomentsPush {
  uint width, height;
  uint row_pixels, pixel_stride, first_image, at;  // as in NormalisePush
};

struct NormalisePush {
  uint width, height;
  uint origin;        // first pixel: the image, or a tile of it, begins there
  uint row_pixels;    // of the raw pixels
  uint pixel_stride;  // 32-bit words from an image to the next
  uint first_image;   // in the pixels
  uint at;            // its number in the pass
  uint out_offset, out_pitch, out_image;
  float mean[3], inverse_std[3];
};

// Zeroes right of the rows and below the planes, which are those left of the rows and above the next plane as well.
struct BorderPush {
  uint height;  // of a plane without its border
  uint offset, pitch, plane;
  uint width;      // of the border
  uint planes[2];  // in either buffer; 0: nothing lies there
};

struct ConvPush {
  uint width, height, images;  // of the output
  uint dilation;
  uint in_offset;  // of the top left tap of the first pixel
  uint in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image, out_planes;
  uint weights, bias;  // in the network's weights
  // Patches: an image is a patch of a level, and what lies outside the level is zero.
  uint margin;  // the first pixel of the output lies so far before that of the patch
  uint level_width, level_height;
};

// winograd4x1_fused: 124 of the 128 bytes that every device has.
struct ColumnPush {
  // As in ConvPush; of a layer that is reduced out_* are those of the 2x2 means.
  uint width, height, images, dilation;
  uint in_offset, in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image, out_planes;
  uint weights, bias;
  // What an item of work has, in workgroups' widths and blocks of output channels, and which counter.
  uint item_steps, item_blocks, counter;
  uint halves;  // 0: means are not asked for
  // The map of a layer that is reduced, as in FeatureMapPush; of the images from split on in another buffer.
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
  uint lane_bits;  // binary logarithm of a workgroup's lanes, see winograd_tile.glsl
  // Blocks of output channels of an item of work, and which counter.
  uint item_blocks, counter;
  // Of a layer that is reduced out_* are those of the 2x2 means.
  uint halves;  // 0: they are not asked for
  uint sums;    // texels of single precision before the sums over channels
};

// Mean over the channels to the maps, and 2x2 means to the next level's input. Or, of a reduced output, to the maps alone: then
// what goes in are sums over eight channels each, a texel for 2x2 pixels.
struct FeatureMapPush {
  uint width, height;
  uint in_offset, in_pitch, in_plane, in_image, in_planes;
  uint out_offset, out_pitch, out_plane, out_image;
  uint map_offset, map_pitch, map_stride, first_image;
  uint first_u, first_v, end_u, end_v;  // which pixels give the maps; they are of a tile, whose first pixel is at map_offset
  float inverse_channels;
  uint halves;  // 0: there is no next level
};

// Convolutional M-estimator of a level, at the residual with which it starts.
struct MEstimatorPush {
  // As in IteratePush:
  uint level, element_stride, map_stride, weight_stride, flags;
  uint max_features;
  uint first_pair;     // of this pass
  uint inputs_stride;  // texels from a pair's input to the next
  uint prior_stride;   // floats from a pair's weight maps to the next
  uint prior_origin;   // LevelInfo::map_offset of the first level that they hold
  uint coarsest;       // 1: there is no coarser level, its weight is 1
  // Patches: patch i of the pass is patch i % patches_per_pair of pair first_pair + i / patches_per_pair.
  uint first_patch, patches, patches_per_pair;
  uint margin;  // of the network's receptive field around a patch
  uint dense;   // patches are 8x8 blocks of the level
  uint whole;   // the network sees the level in one piece, not a piece a patch
};

#ifdef __cplusplus
}  // namespace iclk::shaders
#endif
#endif
