#pragma once
#include <string>

#include <iclk/render/terrain.h>

namespace iclk {

/// Reads a mosaic and an elevation model through GDAL (GeoTIFF and whatever else GDAL opens). The files may have different
/// grids, resolutions and extents, but one coordinate system, projected or local, in metres, with rows along the parallels.
///
///   mosaic      8 bit; grey, grey + alpha, RGB or RGB + more bands; no data: the file's mask, nodata value or alpha
///   elevation   one band of any type, metres, scale and offset applied; no data: the file's mask, nodata value, NaN
///
/// The files are held in memory: 5.4 bytes a pixel of the mosaic and 13 bytes a height, pyramids included.
/// Throws Error(io) that names the file: missing, no raster, truncated; Error(invalid_argument) with the remedy: no
/// georeference, degrees, feet, Web Mercator, rotated rows, different coordinate systems, no overlap, heights that are none;
/// Error(unsupported) for other pixel types; Error(out_of_memory) for files that do not fit.
Terrain load_terrain(const std::string& mosaic, const std::string& elevation);

}  // namespace iclk
