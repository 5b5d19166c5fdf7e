// Layouts of the terrain renderer, declared once for GLSL and C++. Heights and the mosaic are pyramids in texel buffers, level
// after level. Each level is a window of the whole level; RenderLevels has the positions of the windows.
#ifndef ICLK_SHADERS_RENDER_H
#define ICLK_SHADERS_RENDER_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

#define ICLK_RENDER_LEVELS 20

// The most loop iterations of one invocation, for all its rays. Mesa 22.3 silently ends every loop after 65,535 iterations.
// Samples of the mosaic take up to 4,160 of them and lenses 975.
#define ICLK_RENDER_STEPS 60000

// Models of lens distortion.
#define ICLK_LENS_NONE 0
#define ICLK_LENS_RADTAN 1
#define ICLK_LENS_EQUIDISTANT 2

// The height of a cell without data, which stops no ray.
#define ICLK_RENDER_HOLE -1e30

// The window of a level that is in the buffer: texels x .. x + width - 1 of the level, rows packed, from element `offset`.
struct RenderWindow {
  int x, y, width, height;
  int offset;
  int unused0, unused1, unused2;  // std140 pads the elements of an array to 16 bytes
};

// Level 0 of `relief` has the heights at the grid's points; level k + 1 the greatest height of each square of 2^k x 2^k cells.
struct RenderLevels {
  RenderWindow relief[ICLK_RENDER_LEVELS];
  RenderWindow mosaic[ICLK_RENDER_LEVELS];
  // The same for every view.
  float cells_per_metre_x, cells_per_metre_y;
  float texels_per_metre_x, texels_per_metre_y;
  uint background;  // rgba8, where a ray hits no ground
  uint unused0, unused1, unused2;
};

// One view, or a tile of one. Lengths are in metres of the map. All positions are relative to the camera, so that single
// precision suffices for every position of the map.
struct RenderPush {
  // The direction of the ray through pixel (u, v) is u ray_u + v ray_v + ray_0; x east, y north, z up. Its component along the
  // optical axis is 1, so its parameter is the z-depth. With a lens, ray_u and ray_v are the camera's axes x and y, and ray_0
  // is the lens's limit, p1 and p2.
  float ray_u[3], ray_v[3], ray_0[3];
  float lens[8];                  // fx, fy, cx, cy, four radial coefficients; not read without a lens
  float height_high, height_low;  // of the camera; the sum is its height
  float top;                      // upper bound of the ground
  int cell_x, cell_y;             // of the camera in the grid of heights; may be outside
  float cell_fraction_x, cell_fraction_y;
  int texel_x, texel_y;                      // a texel near the camera, at the corner of a texel of the coarsest level
  float texel_fraction_x, texel_fraction_y;  // camera minus that texel, in texels
  uint size;                                 // of the view: width | height << 16
  uint corner;                               // of the tile: x | y << 16
  uint tile;                                 // width | height << 16
  uint levels;  // coarsest of the heights | coarsest of the mosaic << 8 | finest of the mosaic << 16
};

#ifdef __cplusplus
static_assert(sizeof(RenderPush) <= 128);
}  // namespace iclk::shaders
#endif
#endif
