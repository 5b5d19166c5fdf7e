#pragma once
#include <memory>
#include <optional>
#include <string>

#include <Eigen/Core>

#include <iclk/render/terrain.h>

namespace iclk {

/// Reads a mosaic and an elevation model with GDAL (GeoTIFF and all other formats that GDAL opens). The files may have
/// different grids, resolutions and extents. They must have the same coordinate system, projected or local, in metres, with
/// north-up rows.
///
/// - mosaic: 8 bit; grey, grey + alpha, RGB or RGB + more bands; no data: the mask, nodata value or alpha of the file
/// - elevation: one band of any type, metres, scale and offset applied; no data: the mask or nodata value of the file, or NaN
///
/// The files stay in memory: 5.4 bytes per pixel of the mosaic and 13 bytes per height, including pyramids.
/// Throws Error(io) that names a file that is missing, truncated or no raster. Throws Error(invalid_argument) with the remedy
/// for: no georeference, degrees, feet, Web Mercator, rotated rows, different coordinate systems, no overlap, invalid heights.
/// Throws Error(unsupported) for other pixel types; Error(out_of_memory) for files that do not fit.
Terrain load_terrain(const std::string& mosaic, const std::string& elevation);

/// The coordinate system of a raster.
class MapSystem {
 public:
  /// Throws the errors of load_terrain() for a file that GDAL cannot read.
  explicit MapSystem(const std::string& raster);
  ~MapSystem();

  /// False: the raster names no system, or a local one. Then its places have no latitude.
  bool on_earth() const;
  /// Latitude and longitude in degrees, WGS 84, of a place on the map, m; empty unless on_earth().
  std::optional<Eigen::Vector2d> lat_lon(double x, double y) const;
  /// The place on the map, m. Empty unless on_earth(), and for a latitude and longitude that the system does not cover.
  std::optional<Eigen::Vector2d> place(double latitude, double longitude) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
