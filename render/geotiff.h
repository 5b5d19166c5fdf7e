#pragma once
#include <memory>
#include <optional>
#include <string>

#include <Eigen/Core>

#include <iclk/render/terrain_source.h>

namespace iclk {

/// The coordinate system of a map.
class MapSystem {
 public:
  /// That of maps whose mosaic is this raster: its own, if it is projected and in metres on the ground. Otherwise (degrees,
  /// feet, Web Mercator) it is the UTM zone of the raster's centre. Throws the errors of GeoMap for a file that GDAL cannot
  /// read.
  explicit MapSystem(const std::string& raster);
  ~MapSystem();

  /// False: the raster names no system, or a local one. Then its places have no latitude.
  bool on_earth() const;
  /// For example "WGS 84 / UTM zone 33N"; empty unless on_earth().
  const std::string& name() const;
  /// Latitude and longitude in degrees, WGS 84, of a place on the map, m; empty unless on_earth().
  std::optional<Eigen::Vector2d> lat_lon(double x, double y) const;
  /// The place on the map, m. Empty unless on_earth(), and for a latitude and longitude that the system does not cover.
  std::optional<Eigen::Vector2d> place(double latitude, double longitude) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// A mosaic and an elevation model that GDAL reads (GeoTIFF, COG, VRT, and all other formats that it opens). The files may have
/// different grids, resolutions, extents and coordinate systems. What is not in the map's system, or not with north up, is
/// resampled as it is read.
///
/// - mosaic: 8 bit; grey, grey + alpha, RGB or RGB + more bands; no data: the mask, nodata value or alpha of the file
/// - elevation: one band of any type, metres, scale and offset applied; no data: the mask or nodata value of the file, or NaN
///
/// One thread at a time.
class GeoMap : public TerrainSource {
 public:
  /// Opens the files; reads no pixels. Throws Error(io) that names a file that is missing, truncated or no raster. Throws
  /// Error(invalid_argument) with the remedy for: no georeference, heights in feet, no overlap. Throws Error(unsupported) for
  /// other pixel types.
  GeoMap(const std::string& mosaic, const std::string& elevation);
  ~GeoMap() override;

  const MapSystem& system() const;
  MapBox extent() const override;
  double spacing() const;  ///< m between heights, the larger of both directions
  /// At most 2^23 pixels of the mosaic and 2^21 heights: 140 MB with their pyramids. GDAL keeps up to 64 MB of the files'
  /// blocks (GDAL_CACHEMAX). Throws Error(io); Error(invalid_argument) for impossible heights.
  std::shared_ptr<const Terrain> window(const MapBox& box, double texel) const override;
  /// All of both files, with all pixels: 5.4 bytes per pixel of the mosaic and 13 bytes per height, including pyramids. Throws
  /// the errors of window(), and Error(unsupported) if that does not fit into memory.
  Terrain whole() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
