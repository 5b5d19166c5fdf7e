#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/lens.h>
#include <iclk/align/se3.h>
#include <iclk/render/internal/levels.h>
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

/// Undistorts a rectangle of pixels, up to their outer edges: the box of the same rays in a pinhole with the same intrinsics.
/// Nothing if no pixel lies in the domain of the lens. The box bounds the pixels' centres, and also their edges if the lens is
/// smooth.
std::optional<PixelBox> pinhole_box(const Camera& camera, const Lens& lens, const PixelRect& pixels);

/// A bound of the part of the map, inside `extent`, above which rays through `seen` pass between the heights `lowest` and
/// `highest`. It follows from the corners of the clipped frustum and may be empty.
MapBox footprint(const Camera& camera, const SE3& T_WC, const PixelBox& seen, double lowest, double highest,
                 const MapBox& extent);

/// The windows of all levels of a pyramid that cover a part of the map.
struct Windows {
  std::array<shaders::RenderWindow, ICLK_RENDER_LEVELS> levels{};
  uint64_t elements = 0;
};

/// Windows that cover every level completely.
template <typename T>
Windows whole(const std::vector<RasterLevel<T>>& levels);
/// Windows of a relief_levels() pyramid with all cells that touch the box.
Windows relief_windows(const std::vector<RasterLevel<float>>& levels, const Grid& grid, const MapBox& box);
/// Windows of a mosaic_levels() pyramid with all texels that filtering inside the box reads. Levels finer than `finest` have
/// none.
Windows mosaic_windows(const std::vector<RasterLevel<uint32_t>>& levels, const Grid& grid, const MapBox& box, int finest);

/// Copies the windows to `out`, which must have room for windows.elements; level 0 is copied from `level_0`.
template <typename T>
void copy_windows(const Windows& windows, const std::vector<RasterLevel<T>>& levels, const std::vector<T>& level_0, T* out);

}  // namespace iclk
