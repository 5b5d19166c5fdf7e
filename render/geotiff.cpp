#include <iclk/render/geotiff.h>

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <new>
#include <type_traits>

#include <cpl_conv.h>
#include <cpl_error.h>
#include <gdal.h>
#include <ogr_srs_api.h>

#include <iclk/engine/error.h>
#include <iclk/render/text.h>

namespace iclk {

using internal::number;

namespace {

constexpr int kLargestSide = 1 << 19;
// Rows that GDAL reads at a time: whole blocks of files with strips or tiles of up to this many rows.
constexpr int kRows = 256;

/// Collects the messages of GDAL for error messages; nothing is printed.
class Messages {
 public:
  Messages() { CPLPushErrorHandlerEx(&Messages::take, this); }
  ~Messages() { CPLPopErrorHandler(); }
  Messages(const Messages&) = delete;
  Messages& operator=(const Messages&) = delete;
  std::string why() const { return last_.empty() ? "" : " (GDAL: " + last_ + ")"; }

 private:
  static void take(CPLErr severity, CPLErrorNum, const char* text) {
    if (severity >= CE_Failure) static_cast<Messages*>(CPLGetErrorHandlerUserData())->last_ = std::string(text).substr(0, 200);
  }
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

void register_drivers() {
  static const bool registered = (GDALAllRegister(), true);
  (void)registered;
}

[[noreturn]] void bad(const std::string& path, const std::string& why) {
  throw Error(ErrorCode::invalid_argument, path + " " + why);
}

Dataset open(const std::string& path, const Messages& messages) {
  struct stat status = {};
  if (::stat(path.c_str(), &status) != 0) throw Error(ErrorCode::io, "cannot read " + path + ": no such file");
  Dataset dataset(GDALOpenEx(path.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, nullptr, nullptr, nullptr));
  if (!dataset)
    throw Error(ErrorCode::io, "cannot read " + path + ": damaged, or in a format that GDAL cannot read" + messages.why());
  if (GDALGetRasterCount(dataset.get()) < 1) throw Error(ErrorCode::io, "cannot read " + path + ": it has no band");
  return dataset;
}

/// The horizontal part of a data set's coordinate system, or null. Throws unless its lengths and its heights are metres.
System system_of(const std::string& path, GDALDatasetH dataset) {
  const OGRSpatialReferenceH given = GDALGetSpatialRef(dataset);
  if (given == nullptr) return nullptr;  // a georeference without a coordinate system: assumed to be local metres
  System system(OSRClone(given));
  const auto check_unit = [&](double metres, const char* unit, const char* of) {
    if (std::abs(metres - 1) > 1e-9)
      bad(path, std::string("has ") + of + " in '" + (unit ? unit : "?") + "' of " + number(metres) +
                    " m; convert it to metres: gdalwarp -t_srs with a system in metres");
  };
  char* unit = nullptr;
  if (OSRIsCompound(system.get())) {
    const double metres = OSRGetTargetLinearUnits(system.get(), "VERT_CS", &unit);
    check_unit(metres, unit, "heights");
    OSRStripVertical(system.get());
  }
  const std::string remedy = "; the renderer needs metres on the ground: gdalwarp -t_srs EPSG:326xx (your UTM zone) " + path +
                             " projected.tif, for both mosaic and elevation";
  if (OSRIsGeographic(system.get()) || OSRIsGeocentric(system.get()))
    bad(path, "is not projected: its coordinates are degrees of longitude and latitude, or geocentric" + remedy);
  const char* code = OSRGetAuthorityCode(system.get(), nullptr);
  if (code != nullptr && std::string(code) == "3857")
    bad(path, "is in Web Mercator, whose metres differ from metres on the ground by 1 / cos(latitude)" + remedy);
  const double metres = OSRGetLinearUnits(system.get(), &unit);
  check_unit(metres, unit, "lengths");
  return system;
}

/// Whether two coordinate systems are equal, even if programs write them differently.
bool same(OGRSpatialReferenceH a, OGRSpatialReferenceH b) {
  const char* options[] = {"CRITERION=EQUIVALENT", "IGNORE_DATA_AXIS_TO_SRS_AXIS_MAPPING=YES", "IGNORE_COORDINATE_EPOCH=YES",
                           nullptr};
  return OSRIsSameEx(a, b, options) != 0;
}

Grid grid_of(const std::string& path, GDALDatasetH dataset) {
  const int width = GDALGetRasterXSize(dataset), height = GDALGetRasterYSize(dataset);
  double g[6];
  if (GDALGetGeoTransform(dataset, g) != CE_None)
    bad(path, "has no georeference: set it with gdal_translate -a_ullr LEFT TOP RIGHT BOTTOM (metres)");
  // Less than a hundredth of a pixel over the whole raster is rounding by the program that wrote it.
  const bool turned = std::abs(g[2]) * height > 0.01 * std::abs(g[1]) || std::abs(g[4]) * width > 0.01 * std::abs(g[5]);
  if (turned || !(g[1] > 0) || !(g[5] < 0))
    bad(path, "is rotated or mirrored on the map (geotransform " + number(g[1]) + " " + number(g[2]) + " " + number(g[4]) +
                  " " + number(g[5]) + "); north must be up: run gdalwarp " + path + " north_up.tif");
  if (width > kLargestSide || height > kLargestSide)
    bad(path, "has " + std::to_string(width) + "x" + std::to_string(height) + " pixels, but at most " +
                  std::to_string(kLargestSide) +
                  " per side are allowed: cut it with gdal_translate -projwin, or shrink it with -outsize");
  return {width, height, g[0], g[3], g[1], -g[5]};
}

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

void read(const std::string& path, GDALRasterBandH band, const Grid& grid, int row, int rows, void* out, GDALDataType type,
          int pixel_bytes, const Messages& messages) {
  if (GDALRasterIO(band, GF_Read, 0, row, grid.width, rows, out, grid.width, rows, type, pixel_bytes,
                   pixel_bytes * grid.width) != CE_None)
    throw Error(ErrorCode::io, "cannot read " + path + ": rows " + std::to_string(row) + " to " +
                                   std::to_string(row + rows - 1) + " are damaged or the file is truncated" + messages.why());
}

void read_mosaic(const std::string& path, GDALDatasetH dataset, Terrain& terrain, const Messages& messages) {
  const int bands = GDALGetRasterCount(dataset);
  const GDALRasterBandH first = GDALGetRasterBand(dataset, 1);
  if (GDALGetRasterColorTable(first) != nullptr)
    throw Error(ErrorCode::unsupported, path + " has a palette; convert it: gdal_translate -expand rgb");
  const int colours = bands >= 3 ? 3 : 1;
  for (int b = 1; b <= colours; ++b) {
    const GDALDataType type = GDALGetRasterDataType(GDALGetRasterBand(dataset, b));
    if (type != GDT_Byte)
      throw Error(ErrorCode::unsupported, path + " has pixels of type " + GDALGetDataTypeName(type) +
                                              "; convert it to 8 bits: gdal_translate -ot Byte -scale");
  }
  terrain.mosaic = grid_of(path, dataset);
  terrain.rgba = pixels<uint32_t>(path, terrain.mosaic, 5.4);
  const Grid& grid = terrain.mosaic;
  // A pixel has no data only if all bands lack it: the nodata value of one band may be a colour.
  const bool one_mask = (GDALGetMaskFlags(first) & (GMF_PER_DATASET | GMF_ALL_VALID)) != 0;
  std::vector<uint8_t> mask(static_cast<size_t>(grid.width) * kRows);
  for (int row = 0; row < grid.height; row += kRows) {
    const int rows = std::min(kRows, grid.height - row);
    uint32_t* out = terrain.rgba.data() + static_cast<size_t>(row) * static_cast<size_t>(grid.width);
    const size_t count = static_cast<size_t>(grid.width) * static_cast<size_t>(rows);
    auto* bytes = reinterpret_cast<uint8_t*>(out);
    for (int b = 0; b < 3; ++b)
      read(path, GDALGetRasterBand(dataset, std::min(b + 1, colours)), grid, row, rows, bytes + b, GDT_Byte, 4, messages);
    for (int b = 1; b <= (one_mask ? 1 : colours); ++b) {
      read(path, GDALGetMaskBand(GDALGetRasterBand(dataset, b)), grid, row, rows, mask.data(), GDT_Byte, 1, messages);
      for (size_t i = 0; i < count; ++i)
        if (mask[i] >= 128) bytes[4 * i + 3] = 255;
    }
    for (size_t i = 0; i < count; ++i)
      if (bytes[4 * i + 3] == 0) out[i] = 0;
  }
}

void read_elevation(const std::string& path, GDALDatasetH dataset, Terrain& terrain, const Messages& messages) {
  const GDALRasterBandH band = GDALGetRasterBand(dataset, 1);
  if (GDALGetRasterCount(dataset) != 1)
    throw Error(ErrorCode::unsupported, path + " has " + std::to_string(GDALGetRasterCount(dataset)) +
                                            " bands, but an elevation model has one; are --ortho and --elevation swapped?");
  if (GDALDataTypeIsComplex(GDALGetRasterDataType(band)))
    throw Error(ErrorCode::unsupported, path + " has complex numbers instead of heights");
  const std::string unit = GDALGetRasterUnitType(band) ? GDALGetRasterUnitType(band) : "";
  if (!unit.empty() && unit != "m" && unit != "metre" && unit != "meter" && unit != "metres" && unit != "meters")
    bad(path, "has heights in '" + unit + "'; convert them to metres, for feet with gdal_calc.py --calc \"A*0.3048\"");
  terrain.relief = grid_of(path, dataset);
  const Grid& grid = terrain.relief;
  terrain.height = pixels<float>(path, grid, 13);
  int has_scale = 0, has_offset = 0;
  const double scale = GDALGetRasterScale(band, &has_scale), offset = GDALGetRasterOffset(band, &has_offset);
  std::vector<uint8_t> mask(static_cast<size_t>(grid.width) * kRows);
  std::vector<double> values(static_cast<size_t>(grid.width) * kRows);
  for (int row = 0; row < grid.height; row += kRows) {
    const int rows = std::min(kRows, grid.height - row);
    read(path, band, grid, row, rows, values.data(), GDT_Float64, 8, messages);
    read(path, GDALGetMaskBand(band), grid, row, rows, mask.data(), GDT_Byte, 1, messages);
    float* out = terrain.height.data() + static_cast<size_t>(row) * static_cast<size_t>(grid.width);
    const size_t count = static_cast<size_t>(grid.width) * static_cast<size_t>(rows);
    for (size_t i = 0; i < count; ++i) {
      if (mask[i] != 0 && (values[i] == -9999 || values[i] == -32767 || values[i] == -32768))
        bad(path, "has heights of " + number(values[i]) +
                      " m, which seem to mean no data but are not declared; declare them with gdal_edit.py "
                      "-a_nodata " +
                      number(values[i]) + " " + path);
      const double h = (has_scale ? scale : 1.0) * values[i] + (has_offset ? offset : 0.0);
      out[i] = mask[i] == 0 ? std::nanf("") : static_cast<float>(h);
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

  static std::optional<Eigen::Vector2d> transform(const Transformation& transformation, double a, double b) {
    const Messages quiet;
    double z = 0;
    if (!transformation || !OCTTransform(transformation.get(), 1, &a, &b, &z)) return std::nullopt;
    if (!std::isfinite(a) || !std::isfinite(b)) return std::nullopt;
    return Eigen::Vector2d(a, b);
  }
};

MapSystem::MapSystem(const std::string& raster) : impl_(std::make_unique<Impl>()) {
  register_drivers();
  const Messages messages;
  const Dataset dataset = open(raster, messages);
  const System map = system_of(raster, dataset.get());
  if (!map || OSRIsLocal(map.get())) return;
  const System earth(OSRNewSpatialReference(nullptr));
  OSRImportFromEPSG(earth.get(), 4326);  // latitude first
  OSRSetAxisMappingStrategy(map.get(), OAMS_TRADITIONAL_GIS_ORDER);
  impl_->to_earth.reset(OCTNewCoordinateTransformation(map.get(), earth.get()));
  impl_->to_map.reset(OCTNewCoordinateTransformation(earth.get(), map.get()));
}

MapSystem::~MapSystem() = default;

bool MapSystem::on_earth() const { return impl_->to_earth && impl_->to_map; }

std::optional<Eigen::Vector2d> MapSystem::lat_lon(double x, double y) const { return Impl::transform(impl_->to_earth, x, y); }

std::optional<Eigen::Vector2d> MapSystem::place(double latitude, double longitude) const {
  return Impl::transform(impl_->to_map, latitude, longitude);
}

Terrain load_terrain(const std::string& mosaic, const std::string& elevation) {
  register_drivers();
  const Messages messages;
  const Dataset picture = open(mosaic, messages), heights = open(elevation, messages);
  const System a = system_of(mosaic, picture.get()), b = system_of(elevation, heights.get());
  if (a && b && !OSRIsLocal(a.get()) && !OSRIsLocal(b.get()) && !same(a.get(), b.get())) {
    const auto name = [](OGRSpatialReferenceH system) {
      const char* text = OSRGetName(system);
      return std::string(text ? text : "unnamed");
    };
    bad(mosaic, "is in " + name(a.get()) + ", " + elevation + " in " + name(b.get()) +
                    "; they must be in the same system: gdalwarp -t_srs");
  }
  Terrain terrain;
  read_elevation(elevation, heights.get(), terrain, messages);
  read_mosaic(mosaic, picture.get(), terrain, messages);
  try {
    terrain.check();
  } catch (const Error& e) {
    throw Error(e.code(), mosaic + ", " + elevation + ": " + e.what());
  }
  return terrain;
}

}  // namespace iclk
