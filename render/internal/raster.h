#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include <gdal.h>
#include <ogr_srs_api.h>

#include <iclk/render/terrain.h>

namespace iclk::internal {

/// Collects the messages of GDAL for error messages; nothing is printed.
class Messages {
 public:
  Messages();
  ~Messages();
  Messages(const Messages&) = delete;
  Messages& operator=(const Messages&) = delete;
  std::string why() const { return last_.empty() ? "" : " (GDAL: " + last_ + ")"; }

 private:
  static void take(CPLErr severity, CPLErrorNum, const char* text);
  std::string last_;
};

struct Closer {
  void operator()(GDALDatasetH dataset) const { GDALClose(dataset); }
};
using Dataset = std::unique_ptr<void, Closer>;
struct Releaser {
  void operator()(OGRSpatialReferenceH system) const { OSRDestroySpatialReference(system); }
};
using System = std::unique_ptr<std::remove_pointer_t<OGRSpatialReferenceH>, Releaser>;

[[noreturn]] void bad(const std::string& path, const std::string& why);

/// A raster file, and where it lies on a map.
class Raster {
 public:
  /// Pixels of a data set: step x step of them, from (x, y) on, make one pixel of `grid`.
  struct Part {
    Dataset warped;  // holds `dataset` where it was made for this part
    GDALDatasetH dataset = nullptr;
    int x = 0, y = 0, step = 1;
    Grid grid;
  };

  /// Opens the file. Throws Error(io); Error(invalid_argument) without a georeference or with heights that are not in metres.
  explicit Raster(const std::string& path);

  const std::string& path() const { return path_; }
  GDALDatasetH dataset() const { return dataset_.get(); }
  /// The system for maps of this raster: its own, if it is projected and in metres on the ground, else the UTM zone of its
  /// centre; null: a local one.
  System map_system() const;
  /// Places the raster on a map of this system; null: a local one. Throws Error(invalid_argument) if that cannot be done.
  void place(OGRSpatialReferenceH system);
  /// On the map. Of a raster in another system or turned: as it is resampled.
  const Grid& grid() const { return grid_; }
  /// The pixels in the box, averaged over step x step; resampled if need be. Null data set: none.
  Part part(const MapBox& box, int step, bool heights) const;
  Part whole(bool heights) const { return part(grid_.box(), 1, heights); }

 private:
  Part direct(const MapBox& box, int step) const;
  Part warped(const MapBox& box, int step, bool heights) const;

  std::string path_;
  Dataset dataset_;
  System own_;
  std::string target_;  // WKT; empty: none
  Grid grid_;
  bool direct_ = true;
};

/// Band `band` of the part, rows row .. row + rows - 1 of its grid.
void read_rows(const std::string& path, GDALRasterBandH band, const Raster::Part& part, int row, int rows, void* out,
               GDALDataType type, int pixel_bytes);

}  // namespace iclk::internal
