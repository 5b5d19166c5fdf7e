#include <iclk/render/geotiff.h>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <new>

#include <iclk/engine/error.h>
#include <iclk/render/internal/raster.h>
#include <iclk/render/internal/text.h>

namespace iclk {

using internal::bad;
using internal::number;
using internal::Raster;
using internal::read_rows;
using internal::System;

namespace {

// Rows that GDAL reads at a time: whole blocks of files with strips or tiles of up to this many rows.
constexpr int kRows = 256;
constexpr double kMosaicPixels = 1 << 23, kHeights = 1 << 21;  // of a window, at most

/// A vector with one element per pixel of the grid. `bytes`: per pixel, including pyramids.
template <typename T>
std::vector<T> pixels(const std::string& path, const Grid& grid, double bytes) {
  const size_t count = static_cast<size_t>(grid.width) * static_cast<size_t>(grid.height);
  // Checked before allocation: the system ends processes that use more memory than there is.
  const double needed = bytes * static_cast<double>(count);
  const double there = static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  const auto refuse = [&] {
    throw Error(ErrorCode::unsupported, path + ": " + std::to_string(grid.width) + "x" + std::to_string(grid.height) +
                                            " pixels take " + number(std::round(needed / (1 << 20))) +
                                            " MiB, but this machine has " + number(std::round(there / (1 << 20))) +
                                            "; cut it with gdal_translate -projwin, or make it coarser with -outsize");
  };
  if (needed > 0.8 * there) refuse();
  try {
    return std::vector<T>(count);
  } catch (const std::bad_alloc&) {
    refuse();
  }
  return {};
}

void check_mosaic(const Raster& raster) {
  const std::string& path = raster.path();
  if (GDALGetRasterColorTable(GDALGetRasterBand(raster.dataset(), 1)) != nullptr)
    throw Error(ErrorCode::unsupported, path + " has a palette; convert it: gdal_translate -expand rgb");
  for (int b = 1; b <= (GDALGetRasterCount(raster.dataset()) >= 3 ? 3 : 1); ++b) {
    const GDALDataType type = GDALGetRasterDataType(GDALGetRasterBand(raster.dataset(), b));
    if (type != GDT_Byte)
      throw Error(ErrorCode::unsupported, path + " has pixels of type " + GDALGetDataTypeName(type) +
                                              "; convert it to 8 bits: gdal_translate -ot Byte -scale");
  }
}

void check_elevation(const Raster& raster) {
  const std::string& path = raster.path();
  const GDALRasterBandH band = GDALGetRasterBand(raster.dataset(), 1);
  if (const int bands = GDALGetRasterCount(raster.dataset()); bands != 1)
    throw Error(ErrorCode::unsupported, path + " has " + std::to_string(bands) +
                                            " bands, but an elevation model has one; are --ortho and --elevation swapped?");
  if (GDALDataTypeIsComplex(GDALGetRasterDataType(band)))
    throw Error(ErrorCode::unsupported, path + " has complex numbers instead of heights");
  const std::string unit = GDALGetRasterUnitType(band) ? GDALGetRasterUnitType(band) : "";
  if (!unit.empty() && unit != "m" && unit != "metre" && unit != "meter" && unit != "metres" && unit != "meters")
    bad(path, "has heights in '" + unit + "'; convert them to metres, for feet with gdal_calc.py --calc \"A*0.3048\"");
}

void read_mosaic(const Raster& raster, const Raster::Part& part, Terrain& terrain) {
  const int colours = GDALGetRasterCount(part.dataset) >= 3 ? 3 : 1;
  const auto band = [&](int b) { return GDALGetRasterBand(part.dataset, std::min(b, colours)); };
  const Grid& grid = terrain.mosaic = part.grid;
  terrain.rgba = pixels<uint32_t>(raster.path(), grid, 5.4);
  // A pixel has no data only if all bands lack it: the nodata value of one band may be a colour.
  const bool one_mask = (GDALGetMaskFlags(band(1)) & (GMF_PER_DATASET | GMF_ALL_VALID)) != 0;
  std::vector<uint8_t> mask(static_cast<size_t>(grid.width) * kRows);
  for (int row = 0; row < grid.height; row += kRows) {
    const int rows = std::min(kRows, grid.height - row);
    uint32_t* out = terrain.rgba.data() + static_cast<size_t>(row) * static_cast<size_t>(grid.width);
    const size_t count = static_cast<size_t>(grid.width) * static_cast<size_t>(rows);
    auto* bytes = reinterpret_cast<uint8_t*>(out);
    for (int b = 0; b < 3; ++b) read_rows(raster.path(), band(b + 1), part, row, rows, bytes + b, GDT_Byte, 4);
    for (int b = 1; b <= (one_mask ? 1 : colours); ++b) {
      read_rows(raster.path(), GDALGetMaskBand(band(b)), part, row, rows, mask.data(), GDT_Byte, 1);
      for (size_t i = 0; i < count; ++i)
        if (mask[i] >= 128) bytes[4 * i + 3] = 255;
    }
    for (size_t i = 0; i < count; ++i)
      if (bytes[4 * i + 3] == 0) out[i] = 0;
  }
}

void read_elevation(const Raster& raster, const Raster::Part& part, Terrain& terrain) {
  const GDALRasterBandH band = GDALGetRasterBand(part.dataset, 1);
  const Grid& grid = terrain.relief = part.grid;
  terrain.height = pixels<float>(raster.path(), grid, 13);
  int has_scale = 0, has_offset = 0;
  const GDALRasterBandH own = GDALGetRasterBand(raster.dataset(), 1);
  const double scale = GDALGetRasterScale(own, &has_scale), offset = GDALGetRasterOffset(own, &has_offset);
  std::vector<uint8_t> mask(static_cast<size_t>(grid.width) * kRows);
  std::vector<double> values(static_cast<size_t>(grid.width) * kRows);
  for (int row = 0; row < grid.height; row += kRows) {
    const int rows = std::min(kRows, grid.height - row);
    read_rows(raster.path(), band, part, row, rows, values.data(), GDT_Float64, 8);
    read_rows(raster.path(), GDALGetMaskBand(band), part, row, rows, mask.data(), GDT_Byte, 1);
    float* out = terrain.height.data() + static_cast<size_t>(row) * static_cast<size_t>(grid.width);
    const size_t count = static_cast<size_t>(grid.width) * static_cast<size_t>(rows);
    for (size_t i = 0; i < count; ++i) {
      if (mask[i] != 0 && (values[i] == -9999 || values[i] == -32767 || values[i] == -32768))
        bad(raster.path(),
            "has heights of " + number(values[i]) +
                " m, which seem to mean no data but are not declared; declare them with gdal_edit.py -a_nodata " +
                number(values[i]) + " " + raster.path());
      const double h = (has_scale ? scale : 1.0) * values[i] + (has_offset ? offset : 0.0);
      out[i] = mask[i] < 128 ? std::nanf("") : static_cast<float>(h);
    }
  }
}

}  // namespace

struct MapSystem::Impl {
  struct Destroyer {
    void operator()(OGRCoordinateTransformationH transformation) const { OCTDestroyCoordinateTransformation(transformation); }
  };
  using Transformation = std::unique_ptr<std::remove_pointer_t<OGRCoordinateTransformationH>, Destroyer>;
  Transformation to_earth, to_map;
  std::string name;

  explicit Impl(System map) {
    if (!map) return;
    const System earth(OSRNewSpatialReference(nullptr));
    OSRImportFromEPSG(earth.get(), 4326);  // latitude first
    OSRSetAxisMappingStrategy(map.get(), OAMS_TRADITIONAL_GIS_ORDER);
    const internal::Messages quiet;
    to_earth.reset(OCTNewCoordinateTransformation(map.get(), earth.get()));
    to_map.reset(OCTNewCoordinateTransformation(earth.get(), map.get()));
    if (const char* text = OSRGetName(map.get()); text && to_earth && to_map) name = text;
  }

  static std::optional<Eigen::Vector2d> transform(const Transformation& transformation, double a, double b) {
    const internal::Messages quiet;
    double z = 0;
    if (!transformation || !OCTTransform(transformation.get(), 1, &a, &b, &z)) return std::nullopt;
    if (!std::isfinite(a) || !std::isfinite(b)) return std::nullopt;
    return Eigen::Vector2d(a, b);
  }
};

MapSystem::MapSystem(const std::string& raster) : impl_(std::make_unique<Impl>(Raster(raster).map_system())) {}
MapSystem::~MapSystem() = default;

bool MapSystem::on_earth() const { return impl_->to_earth && impl_->to_map; }

const std::string& MapSystem::name() const { return impl_->name; }

std::optional<Eigen::Vector2d> MapSystem::lat_lon(double x, double y) const { return Impl::transform(impl_->to_earth, x, y); }

std::optional<Eigen::Vector2d> MapSystem::place(double latitude, double longitude) const {
  return Impl::transform(impl_->to_map, latitude, longitude);
}

struct GeoMap::Impl {
  Raster mosaic, elevation;
  MapSystem system;
  MapBox extent;

  Impl(const std::string& mosaic_path, const std::string& elevation_path)
      : mosaic(mosaic_path), elevation(elevation_path), system(mosaic_path) {
    check_elevation(elevation);
    check_mosaic(mosaic);
    System map = mosaic.map_system();
    if (!map) map = elevation.map_system();
    mosaic.place(map.get());
    elevation.place(map.get());
    extent = Terrain{elevation.grid(), {}, mosaic.grid(), {}}.extent();
    if (extent.empty())
      bad(mosaic_path, "(" + mosaic.grid().box().text() + ") and " + elevation_path + " (" + elevation.grid().box().text() +
                           ") do not overlap; are both of the same place?");
  }

  Terrain read(const MapBox& mosaic_box, int mosaic_step, const MapBox& relief_box, int relief_step) const {
    const Raster::Part picture = mosaic.part(mosaic_box, mosaic_step, false),
                       heights = elevation.part(relief_box, relief_step, true);
    Terrain terrain;
    if (!picture.dataset || !heights.dataset) return terrain;
    read_elevation(elevation, heights, terrain);
    read_mosaic(mosaic, picture, terrain);
    return terrain;
  }
};

GeoMap::GeoMap(const std::string& mosaic, const std::string& elevation) : impl_(std::make_unique<Impl>(mosaic, elevation)) {}
GeoMap::~GeoMap() = default;

const MapSystem& GeoMap::system() const { return impl_->system; }
MapBox GeoMap::extent() const { return impl_->extent; }
double GeoMap::spacing() const { return std::max(impl_->elevation.grid().step_x, impl_->elevation.grid().step_y); }

std::shared_ptr<const Terrain> GeoMap::window(const MapBox& wanted, double texel) const {
  const MapBox box = wanted.intersection(impl_->extent);
  if (box.empty()) return nullptr;
  const auto step_for = [&](const Grid& grid, double most) {
    int step = 1;
    const double count = box.width() / grid.step_x * box.height() / grid.step_y;
    while (2 * step * grid.step_x <= texel || count / step / step > most) step *= 2;
    return step;
  };
  const int relief_step = step_for(impl_->elevation.grid(), kHeights);
  const double more = 2 * relief_step * std::max(impl_->elevation.grid().step_x, impl_->elevation.grid().step_y);
  const MapBox relief_box{box.left - more, box.bottom - more, box.right + more, box.top + more};
  auto terrain =
      std::make_shared<Terrain>(impl_->read(box, step_for(impl_->mosaic.grid(), kMosaicPixels), relief_box, relief_step));
  const bool empty = std::all_of(terrain->height.begin(), terrain->height.end(), [](float h) { return std::isnan(h); }) ||
                     std::all_of(terrain->rgba.begin(), terrain->rgba.end(), [](uint32_t p) { return p >> 24 == 0; }) ||
                     terrain->relief.width < 2 || terrain->relief.height < 2 || terrain->mosaic.width < 2 ||
                     terrain->mosaic.height < 2;
  if (empty || terrain->extent().empty()) return nullptr;
  terrain->check();
  return terrain;
}

Terrain GeoMap::whole() const {
  const Raster &mosaic = impl_->mosaic, &elevation = impl_->elevation;
  Terrain terrain = impl_->read(mosaic.grid().box(), 1, elevation.grid().box(), 1);
  try {
    terrain.check();
  } catch (const Error& e) {
    throw Error(e.code(), mosaic.path() + ", " + elevation.path() + ": " + e.what());
  }
  return terrain;
}

}  // namespace iclk
