// Layouts of the dense depth sweep, declared once for GLSL and C++.
//
// A volume holds a byte for every pixel and plane, sixteen planes a texel, the planes of a pixel side by side. Planes are
// uniform in inverse depth: w = first + step * plane.
#ifndef ICLK_SHADERS_DEPTH_H
#define ICLK_SHADERS_DEPTH_H

#ifdef __cplusplus
#include <array>
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
using vec4 = std::array<float, 4>;
#endif

#define ICLK_DEPTH_VIEWS 8
#define ICLK_DEPTH_PATHS 8
#define ICLK_DEPTH_PLANES 256
// Planes of a texel.
#define ICLK_DEPTH_QUAD 16

// Centre-symmetric census over 9x7: a bit a pair of pixels, the largest cost.
#define ICLK_CENSUS_RADIUS_U 4
#define ICLK_CENSUS_RADIUS_V 3
#define ICLK_CENSUS_BITS 31u
// Cost where a plane lies outside every view, half of a chance match's: above what a true match costs, below the best of many
// chance matches, so that neighbours decide.
#define ICLK_DEPTH_OUTSIDE 8u
// A plane so far from a prior costs as much as the worst match.
#define ICLK_DEPTH_PRIOR_SLOPE 4.0

#define ICLK_POLISH_RADIUS 3
// Largest path cost is ICLK_CENSUS_BITS + p2, a byte.
#define ICLK_DEPTH_MAX_P2 220

// Where the reference's pixel (u, v) of inverse depth w lies in a view: x = row_u . (u, v, 1, w), likewise y and z;
// (x / z, y / z) is the pixel, z > 0 in front of the camera.
struct DepthView {
  vec4 row_u, row_v, row_z;
  vec4 back_u, back_v, back_z;  // takes the view's pixel (u, v, 1) to the reference, by the plane in the middle of the range
};

struct DepthViews {
  DepthView view[ICLK_DEPTH_VIEWS];
};

struct DepthPush {
  uint width, height;  // of every image
  // Volumes hold a strip of the reference's rows: its first row and their number. winner.comp answers some of them.
  uint strip, rows;
  uint answered, answered_end;
  uint views;
  float first, step;  // inverse depth of plane 0 and between planes
  int du, dv;         // path.comp: the way of the path; dv is 0 or points where lines are walked to
  uint p1, p2;        // path.comp: penalties of a change by one plane and by more
  float edge;         // path.comp: how much p2 loses a grey level (of 255) of difference
  float uniqueness;   // winner.comp: share by which the second best must be worse
  float tolerance;    // consistent.comp: planes
  uint keep_unseen;   // consistent.comp: 1: what lies outside every view keeps its plane
};

#ifdef __cplusplus
static_assert(sizeof(DepthPush) <= 128);
}  // namespace iclk::shaders
#endif
#endif
