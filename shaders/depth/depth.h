// Layouts of the dense depth sweep, declared once for GLSL and C++.
//
// A volume has one byte per pixel and plane and sixteen planes per texel; the planes of a pixel are adjacent. Planes are
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
// Planes per texel.
#define ICLK_DEPTH_QUAD 16

// Centre-symmetric census over 9x7 pixels: one bit per pair of pixels. The number of bits is the largest cost.
#define ICLK_CENSUS_RADIUS_U 4
#define ICLK_CENSUS_RADIUS_V 3
#define ICLK_CENSUS_BITS 31u
// The cost of a plane outside all views: half of that of a random match. It is above the cost of a true match and below the
// best of many random matches, so that neighbours decide.
#define ICLK_DEPTH_OUTSIDE 8u
// The cost per plane of distance from a prior, up to that of the worst match.
#define ICLK_DEPTH_PRIOR_SLOPE 4.0

#define ICLK_POLISH_RADIUS 3
// The largest path cost is ICLK_CENSUS_BITS + p2, which must fit a byte.
#define ICLK_DEPTH_MAX_P2 220

// Projects the reference's pixel (u, v) with inverse depth w into a view: x = row_u . (u, v, 1, w), and y, z alike. The pixel
// is (x / z, y / z); z > 0 in front of the camera.
struct DepthView {
  vec4 row_u, row_v, row_z;
  vec4 back_u, back_v, back_z;  // maps the view's pixel (u, v, 1) to the reference, on the plane in the middle of the range
};

struct DepthViews {
  DepthView view[ICLK_DEPTH_VIEWS];
};

struct DepthPush {
  uint width, height;  // of every image
  // The first row and the number of rows of the strip in the volumes; winner.comp gives results for the answered rows.
  uint strip, rows;
  uint answered, answered_end;
  uint views;
  float first, step;  // inverse depth of plane 0 and between planes
  int du, dv;         // path.comp: the direction of the path; dv is 0 or the direction in which rows are processed
  uint p1, p2;        // path.comp: penalties of a change by one plane and by more
  float edge;         // path.comp: how much p2 falls per grey level (of 255) of difference
  float uniqueness;   // winner.comp: share by which the second best must be worse
  float tolerance;    // consistent.comp: planes
  uint keep_unseen;   // consistent.comp: 1: pixels outside all views keep their plane
};

#ifdef __cplusplus
static_assert(sizeof(DepthPush) <= 128);
}  // namespace iclk::shaders
#endif
#endif
