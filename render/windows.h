#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/lens.h>
#include <iclk/align/se3.h>
#include <iclk/render/levels.h>
#include <iclk/shaders/render/render.h>

namespace iclk {

/// Pixels x .. x + width - 1 of an image, and the same for y.
struct PixelRect {
  int x = 0, y = 0, width = 0, height = 0;
};

/// A rectangle of the image plane, px.
struct PixelBox {
  double u0 = 0, v0 = 0, u1 = 0, v1 = 0;
};

/// Where the pinhole of the same camera sees what these pixels see through the lens, to their outer edges; nothing where no
/// pixel sees anything. A lens's bound holds for the pixels' centres, and for their edges as far as the lens is smooth.
std::optional<PixelBox> pinhole_box(const Camera& camera, const Lens& lens, const PixelRect& pixels);

/// What of the map any ray through that part of a pinhole's image can pass between the heights `lowest` and `highest`, inside
/// `extent`: a bound, from the corners of the clipped frustum. May be empty.
MapBox footprint(const Camera& camera, const SE3& T_WC, const PixelBox& seen, double lowest, double highest,
                 const MapBox& extent);

/// The windows of all levels of a pyramid that cover a part of the map.
struct Windows {
  std::array<shaders::RenderWindow, ICLK_RENDER_LEVELS> levels{};
  uint64_t elements = 0;
};

/// Every level whole.
template <typename T>
Windows whole(const std::vector<RasterLevel<T>>& levels);
/// Of a relief_levels pyramid, all cells that touch the box.
Windows relief_windows(const std::vector<RasterLevel<float>>& levels, const Grid& grid, const MapBox& box);
/// Of a mosaic_levels pyramid, all texels that filtering inside the box reads; levels finer than `finest` are left out.
Windows mosaic_windows(const std::vector<RasterLevel<uint32_t>>& levels, const Grid& grid, const MapBox& box, int finest);

/// Copies the windows, level 0 from `level_0`, to `out`, which has room for windows.elements.
template <typename T>
void copy_windows(const Windows& windows, const std::vector<RasterLevel<T>>& levels, const std::vector<T>& level_0, T* out);

}  // namespace iclk
