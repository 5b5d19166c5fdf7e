#version 460
// Winograd F(4x4, 3x3) for CPUs. A workgroup transforms ICLK_WINOGRAD_TILES tiles per lane, stores them in a slot of the
// scratch memory, and multiplies them. The next workgroup of the thread uses the same slot, which therefore stays in the cache
// of its core.
//
// A work item (work_items.glsl) is some blocks of output channels of a group of tiles.
// Groups: at least as many as items.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_spirv_intrinsics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#define N 4
#include "network/network.h"
#define ALIASED 20  // SPIR-V: other variables have the same memory
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, rgba32f) spirv_decorate(ALIASED) coherent readonly uniform imageBuffer transformed;
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer weights;
// The counters (work_items.glsl), and one word per slot, which is 1 while it is in use.
spirv_decorate(ALIASED) layout(set = 0, binding = 3, std430) coherent buffer Work { uint work[]; };
spirv_decorate(ALIASED) layout(set = 0, binding = 3, std430) coherent writeonly buffer Slots { vec4 transformed_out[]; };
layout(set = 0, binding = 4) uniform samplerBuffer activations;
// Push constants of the kernels of whole tiles. main() begins with push = constants, because lavapipe repeats slow reads of
// push constants after divergent branches.
layout(push_constant) uniform Push { WinogradPush constants; };
WinogradPush push;
#define M (N + 2)
#include "convolution/winograd_tile.glsl"
#include "convolution/winograd_transform.glsl"
#include "convolution/winograd_sums.glsl"

#include "convolution/work_items.glsl"

// Takes the first free slot. There are as many as lavapipe has threads, and few are used.
uint take_slot() {
  uint slot = ICLK_FUSED_SLOTS - 1u, taken;
  do {
    slot = slot == ICLK_FUSED_SLOTS - 1u ? 0u : slot + 1u;
    taken = 0u;
    if (gl_SubgroupInvocationID == 0u) taken = atomicExchange(work[(ICLK_WORK_COUNTERS + slot) * ICLK_WORK_WORDS], 1u);
  } while (subgroupShuffle(taken, 0u) != 0u);
  memoryBarrier();
  return slot;
}

void leave_slot(uint slot) {
  memoryBarrier();
  if (gl_SubgroupInvocationID == 0u) atomicExchange(work[(ICLK_WORK_COUNTERS + slot) * ICLK_WORK_WORDS], 0u);
}

void main() {
  push = constants;
  const int lanes = int(gl_WorkGroupSize.x), strip = lanes * T;
  uint item = take_item(push.counter), groups = (push.tiles + uint(strip) - 1u) / uint(strip);
  uint parts = (blocks() + push.item_blocks - 1u) / push.item_blocks;
  if (item >= groups * parts) return;
  uint slot = take_slot(), group = item / parts;
  int first = int(group) * strip + int(gl_LocalInvocationIndex), planes = int(push.in_planes);
  int at = ICLK_FUSED_WORK_TEXELS + int(slot) * strip * planes * (M * M) + int(gl_LocalInvocationIndex);
  int t = 0;
  do {
    int index = first + t * lanes;
    Tile tile = tile_at(min(index, int(push.tiles) - 1));
    tile.image = min(tile.image, int(push.images) - 1);  // results of a tile without an image are not written
    int c = 0, plane = int(push.in_offset) + tile.image * int(push.in_image), in_plane = int(push.in_plane);
    do {
      transform_tile(tile, plane + c * in_plane, at + t * lanes + c * strip, planes * strip);
    } while (++c < planes);
  } while (++t < T);
  memoryBarrier();
  uint block = (item - group * parts) * push.item_blocks, end = min(block + push.item_blocks, blocks());
  do {
    multiply(block, strip, at, first);
  } while (++block < end);
  leave_slot(slot);
}
