#pragma once
#include <string>
#include <vector>

#include <cpl_conv.h>
#include <gdal.h>
#include <ogr_srs_api.h>

#include <iclk/render/terrain.h>

namespace iclk::test {

/// A GeoTIFF to be written: bands of doubles, stored in `type`.
struct GeoTiff {
  Grid grid;
  std::vector<std::vector<double>> bands;
  GDALDataType type = GDT_Float32;
  int epsg = 0;                    ///< 0: none
  const char* compound = nullptr;  ///< "EPSG:2056+5728", instead of epsg
  bool georeferenced = true;
  double rotation = 0;  ///< geotransform[2]
  const char* nodata = nullptr;
  double scale = 1, offset = 0;
  bool point = false;  ///< AREA_OR_POINT=Point
  std::string unit;    ///< of the first band
  bool palette = false;
  std::vector<double> mask;  ///< of the data set, or empty

  /// A band from a function of the map.
  GeoTiff& band(auto&& of) {
    bands.emplace_back();
    for (int v = 0; v < grid.height; ++v)
      for (int u = 0; u < grid.width; ++u)
        bands.back().push_back(of(grid.left + (u + 0.5) * grid.step_x, grid.top - (v + 0.5) * grid.step_y));
    return *this;
  }

  void write(const std::string& path) const {
    GDALAllRegister();
    const char* options[] = {"SPARSE_OK=TRUE", nullptr};
    GDALDatasetH file = GDALCreate(GDALGetDriverByName("GTiff"), path.c_str(), grid.width, grid.height,
                                   std::max(1, static_cast<int>(bands.size())), type, const_cast<char**>(options));
    if (georeferenced) {
      double g[6] = {grid.left, grid.step_x, rotation, grid.top, 0, -grid.step_y};
      GDALSetGeoTransform(file, g);
    }
    if (epsg != 0) {
      OGRSpatialReferenceH system = OSRNewSpatialReference(nullptr);
      if (compound != nullptr)
        OSRSetFromUserInput(system, compound);
      else
        OSRImportFromEPSG(system, epsg);
      GDALSetSpatialRef(file, system);
      OSRDestroySpatialReference(system);
    }
    if (point) GDALSetMetadataItem(file, "AREA_OR_POINT", "Point", nullptr);
    if (!mask.empty()) {
      CPLSetConfigOption("GDAL_TIFF_INTERNAL_MASK", "YES");
      GDALCreateDatasetMaskBand(file, GMF_PER_DATASET);
      write_band(GDALGetMaskBand(GDALGetRasterBand(file, 1)), mask);
    }
    for (size_t b = 0; b < bands.size(); ++b) {
      GDALRasterBandH out = GDALGetRasterBand(file, static_cast<int>(b) + 1);
      if (nodata) GDALSetRasterNoDataValue(out, std::stod(nodata));
      if (scale != 1) GDALSetRasterScale(out, scale);
      if (offset != 0) GDALSetRasterOffset(out, offset);
      if (!unit.empty()) GDALSetRasterUnitType(out, unit.c_str());
      if (palette) {
        GDALColorTableH table = GDALCreateColorTable(GPI_RGB);
        const GDALColorEntry grey = {100, 100, 100, 255};
        GDALSetColorEntry(table, 0, &grey);
        GDALSetRasterColorTable(out, table);
        GDALDestroyColorTable(table);
      }
      if (!bands[b].empty()) write_band(out, bands[b]);
    }
    GDALClose(file);
  }

 private:
  void write_band(GDALRasterBandH band, const std::vector<double>& values) const {
    const CPLErr error = GDALRasterIO(band, GF_Write, 0, 0, grid.width, grid.height, const_cast<double*>(values.data()),
                                      grid.width, grid.height, GDT_Float64, 0, 0);
    if (error != CE_None) std::abort();
  }
};

}  // namespace iclk::test
