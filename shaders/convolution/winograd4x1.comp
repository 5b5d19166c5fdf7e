#version 460
// 3x3 convolution, bias and ELU by Winograd F(4, 3) along columns (winograd4x1_sums.glsl), weights shared by subgroup shuffles.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#include "convolution/conv_column.glsl"
const bool PAIRED = false;
#include "convolution/winograd4x1_sums.glsl"

void main() {
  Column column = column_of(4 * T);
  int rows[6 * T];
  find_rows(column.y, rows);
  vec4 acc[T][6][2];
  sums_of(gl_WorkGroupID.x, int(push.in_offset) + column.image * int(push.in_image) + column.x, rows, acc);
  if (column.live) write_whole(gl_WorkGroupID.x, acc, column.image, column.x, column.y);
}
