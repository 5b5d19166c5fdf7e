// A 3x3 convolution whose invocations compute eight output channels of some pixels of a column, `dilation` apart. The input has
// a border of zeros, so that taps need no tests.
// Groups: (blocks of eight output channels, n, m), n m >= positions / local size.
#extension GL_EXT_control_flow_attributes : require
#include "network/network.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(1, vec4, weights)
#define FETCH TEXEL
#define IN_BINDING 0
#define OUT_BINDING 2
#include "network/activations.glsl"
#ifdef ITEMS
// main() begins with push = constants, because lavapipe repeats slow reads of push constants after divergent branches.
layout(push_constant) uniform Push { ColumnPush constants; };
ColumnPush push;
layout(set = 0, binding = 3, std430) coherent buffer Work { uint work[]; };
#else
layout(push_constant) uniform Push { ConvPush push; };
#endif
#include "convolution/conv_weights.glsl"

struct Column {
  bool live;  // false: a copy of the last one; no lane returns, because others may need its weights
  int image, x, y;
};

// `rows`: pixels per invocation.
Column column_of(int rows) {
  int id = int((gl_WorkGroupID.z * gl_NumWorkGroups.y + gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationIndex);
  int width = int(push.width), height = int(push.height), dilation = int(push.dilation);
  int span = rows * dilation, row_blocks = (height + span - 1) / span * dilation;
  int positions = int(push.images) * row_blocks * width;
  bool live = id < positions;
  id = min(id, positions - 1);
  int block = id / width, x = id - block * width;
  int image = block / row_blocks;
  block -= image * row_blocks;
  return Column(live, image, x, (block / dilation) * span + block % dilation);
}
