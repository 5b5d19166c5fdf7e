#include <iclk/render/internal/raster.h>

#include <sys/stat.h>

#include <algorithm>
#include <cmath>

#include <cpl_conv.h>
#include <cpl_error.h>
#include <cpl_string.h>
#include <gdal_alg.h>
#include <gdal_utils.h>

#include <iclk/engine/error.h>
#include <iclk/render/internal/text.h>

namespace iclk::internal {
namespace {

constexpr int kLargestSide = 1 << 19;
constexpr int64_t kBlockCache = 64 << 20;  // bytes that GDAL keeps of the files

void prepare_gdal() {
  static const bool done = [] {
    GDALAllRegister();
    if (CPLGetConfigOption("GDAL_CACHEMAX", nullptr) == nullptr) GDALSetCacheMax64(kBlockCache);
    return true;
  }();
  (void)done;
}

Dataset open(const std::string& path) {
  struct stat status = {};
  if (::stat(path.c_str(), &status) != 0) throw Error(ErrorCode::io, "cannot read " + path + ": no such file");
  const Messages messages;
  Dataset dataset(GDALOpenEx(path.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, nullptr, nullptr, nullptr));
  if (!dataset)
    throw Error(ErrorCode::io, "cannot read " + path + ": damaged, or in a format that GDAL cannot read" + messages.why());
  if (GDALGetRasterCount(dataset.get()) < 1) throw Error(ErrorCode::io, "cannot read " + path + ": it has no band");
  return dataset;
}

void need_metres(const std::string& path, double metres, const char* unit, const char* of) {
  if (std::abs(metres - 1) > 1e-9)
    bad(path, std::string("has ") + of + " in '" + (unit ? unit : "?") + "' of " + number(metres) +
                  " m; convert it to metres: gdalwarp -t_srs with a system in metres");
}

/// The horizontal part of a data set's coordinate system, or null for none or a local one.
System system_of(const std::string& path, GDALDatasetH dataset) {
  const OGRSpatialReferenceH given = GDALGetSpatialRef(dataset);
  if (given == nullptr) return nullptr;  // a georeference without a coordinate system: assumed to be local metres
  System system(OSRClone(given));
  char* unit = nullptr;
  if (OSRIsCompound(system.get())) {
    const double metres = OSRGetTargetLinearUnits(system.get(), "VERT_CS", &unit);
    need_metres(path, metres, unit, "heights");
    OSRStripVertical(system.get());
  }
  if (OSRIsGeocentric(system.get())) bad(path, "has geocentric coordinates; project it: gdalwarp -t_srs EPSG:326xx");
  if (!OSRIsLocal(system.get())) return system;
  const double metres = OSRGetLinearUnits(system.get(), &unit);
  need_metres(path, metres, unit, "lengths");
  return nullptr;
}

/// Whether a length on the map is one on the ground, in metres.
bool metric(OGRSpatialReferenceH system) {
  const char* code = OSRGetAuthorityCode(system, nullptr);
  const char* projection = OSRGetAttrValue(system, "PROJECTION", 0);
  const bool web = (code && std::string(code) == "3857") || (projection && std::string(projection).starts_with("Mercator"));
  return OSRIsProjected(system) && !web && std::abs(OSRGetLinearUnits(system, nullptr) - 1) < 1e-9;
}

/// Whether two coordinate systems are equal, even if programs write them differently.
bool same(OGRSpatialReferenceH a, OGRSpatialReferenceH b) {
  const char* options[] = {"CRITERION=EQUIVALENT", "IGNORE_DATA_AXIS_TO_SRS_AXIS_MAPPING=YES", "IGNORE_COORDINATE_EPOCH=YES",
                           nullptr};
  return OSRIsSameEx(a, b, options) != 0;
}

void check_size(const std::string& path, int width, int height) {
  if (width > kLargestSide || height > kLargestSide)
    bad(path, "has " + std::to_string(width) + "x" + std::to_string(height) + " pixels, but at most " +
                  std::to_string(kLargestSide) +
                  " per side are allowed: cut it with gdal_translate -projwin, or shrink it with -outsize");
}

/// The grid of a raster with north up; an empty one if it is turned or mirrored.
Grid own_grid(GDALDatasetH dataset) {
  const int width = GDALGetRasterXSize(dataset), height = GDALGetRasterYSize(dataset);
  double g[6];
  GDALGetGeoTransform(dataset, g);
  // Less than a hundredth of a pixel over the whole raster is rounding by the program that wrote it.
  const bool turned = std::abs(g[2]) * height > 0.01 * std::abs(g[1]) || std::abs(g[4]) * width > 0.01 * std::abs(g[5]);
  if (turned || !(g[1] > 0) || !(g[5] < 0)) return {};
  return {width, height, g[0], g[3], g[1], -g[5]};
}

/// The centre of a raster: longitude and latitude.
Eigen::Vector2d centre(const std::string& path, GDALDatasetH dataset, OGRSpatialReferenceH own) {
  double g[6];
  GDALGetGeoTransform(dataset, g);
  const double u = 0.5 * GDALGetRasterXSize(dataset), v = 0.5 * GDALGetRasterYSize(dataset);
  double x = g[0] + u * g[1] + v * g[2], y = g[3] + u * g[4] + v * g[5], z = 0;
  const System earth(OSRNewSpatialReference(nullptr)), from(OSRClone(own));
  OSRImportFromEPSG(earth.get(), 4326);
  for (const auto& system : {earth.get(), from.get()}) OSRSetAxisMappingStrategy(system, OAMS_TRADITIONAL_GIS_ORDER);
  const Messages messages;
  OGRCoordinateTransformationH transformation = OCTNewCoordinateTransformation(from.get(), earth.get());
  const bool done = transformation && OCTTransform(transformation, 1, &x, &y, &z) && std::isfinite(x) && std::isfinite(y);
  if (transformation) OCTDestroyCoordinateTransformation(transformation);
  if (!done) bad(path, "has coordinates that its system does not cover" + messages.why());
  return {x, y};
}

System utm_at(const Eigen::Vector2d& lon_lat) {
  const bool north = lon_lat.y() >= 0;
  const int zone = std::clamp(static_cast<int>(std::floor((lon_lat.x() + 180) / 6)) + 1, 1, 60);
  System system(OSRNewSpatialReference(nullptr));
  const bool polar = lon_lat.y() > 84 || lon_lat.y() < -80;
  OSRImportFromEPSG(system.get(), polar ? (north ? 5041 : 5042) : (north ? 32600 : 32700) + zone);
  return system;
}

/// The grid to which GDAL would resample the raster.
Grid resampled_grid(const std::string& path, GDALDatasetH dataset, const std::string& target) {
  const Messages messages;
  char** options = nullptr;
  if (!target.empty()) options = CSLSetNameValue(options, "DST_SRS", target.c_str());
  void* transformer = GDALCreateGenImgProjTransformer2(dataset, nullptr, options);
  CSLDestroy(options);
  double g[6], extents[4];
  int width = 0, height = 0;
  const bool done = transformer && GDALSuggestedWarpOutput2(dataset, GDALGenImgProjTransform, transformer, g, &width, &height,
                                                            extents, 0) == CE_None;
  if (transformer) GDALDestroyGenImgProjTransformer(transformer);
  if (!done || width < 1 || height < 1) bad(path, "cannot be brought into the system of the map" + messages.why());
  check_size(path, width, height);
  return {width, height, g[0], g[3], g[1], -g[5]};
}

}  // namespace

Messages::Messages() { CPLPushErrorHandlerEx(&Messages::take, this); }
Messages::~Messages() { CPLPopErrorHandler(); }
void Messages::take(CPLErr severity, CPLErrorNum, const char* text) {
  if (severity >= CE_Failure) static_cast<Messages*>(CPLGetErrorHandlerUserData())->last_ = std::string(text).substr(0, 200);
}

void bad(const std::string& path, const std::string& why) { throw Error(ErrorCode::invalid_argument, path + " " + why); }

Raster::Raster(const std::string& path) : path_(path) {
  prepare_gdal();
  dataset_ = open(path);
  own_ = system_of(path, dataset_.get());
  double g[6];
  if (GDALGetGeoTransform(dataset_.get(), g) != CE_None)
    bad(path, "has no georeference: set it with gdal_translate -a_ullr LEFT TOP RIGHT BOTTOM (metres)");
  check_size(path, GDALGetRasterXSize(dataset_.get()), GDALGetRasterYSize(dataset_.get()));
}

System Raster::map_system() const {
  if (!own_) return nullptr;
  if (metric(own_.get())) return System(OSRClone(own_.get()));
  return utm_at(centre(path_, dataset_.get(), own_.get()));
}

void Raster::place(OGRSpatialReferenceH system) {
  const bool in_place = !own_ || !system || same(own_.get(), system);
  if (system && !own_) {
    // Metres are assumed; a map in degrees shows that the file is not of it.
    const Grid grid = own_grid(dataset_.get());
    if (grid.width > 0 && std::max(std::abs(grid.left), std::abs(grid.top)) <= 360 && grid.step_x < 0.1)
      bad(path_, "names no coordinate system and seems to be in degrees; name it: gdal_edit.py -a_srs EPSG:4326 " + path_);
  }
  grid_ = own_grid(dataset_.get());
  direct_ = in_place && grid_.width > 0;
  if (direct_) return;
  if (!in_place) {
    char* text = nullptr;
    OSRExportToWkt(system, &text);
    target_ = text ? text : "";
    CPLFree(text);
  }
  grid_ = resampled_grid(path_, dataset_.get(), target_);
}

Raster::Part Raster::part(const MapBox& box, int step, bool heights) const {
  return direct_ ? direct(box, step) : warped(box, step, heights);
}

Raster::Part Raster::direct(const MapBox& box, int step) const {
  const auto range = [&](double from, double to, int size) {
    // Positions next to an edge of a pixel are on it.
    const int first = static_cast<int>(std::clamp(std::floor(from + 1e-6), 0.0, 1.0 * size)) / step;
    const int last = static_cast<int>(std::clamp(std::ceil(to - 1e-6), 0.0, 1.0 * size));
    return std::pair(first * step, std::min((last - first * step + step - 1) / step, (size - first * step) / step));
  };
  const Grid& g = grid_;
  const auto [x, width] = range((box.left - g.left) / g.step_x, (box.right - g.left) / g.step_x, g.width);
  const auto [y, height] = range((g.top - box.top) / g.step_y, (g.top - box.bottom) / g.step_y, g.height);
  Part part;
  if (width < 1 || height < 1) return part;
  part.dataset = dataset_.get(), part.x = x, part.y = y, part.step = step;
  part.grid = {width, height, g.left + x * g.step_x, g.top - y * g.step_y, step * g.step_x, step * g.step_y};
  return part;
}

Raster::Part Raster::warped(const MapBox& wanted, int step, bool heights) const {
  const double size = step * grid_.step_x;
  const MapBox box = wanted.intersection(grid_.box());
  // On a grid that does not depend on the box.
  const double left = size * std::floor(box.left / size + 1e-6), top = size * std::ceil(box.top / size - 1e-6);
  const int width = static_cast<int>(std::ceil((box.right - left) / size - 1e-6)),
            height = static_cast<int>(std::ceil((top - box.bottom) / size - 1e-6));
  Part part;
  if (width < 1 || height < 1) return part;
  part.grid = {width, height, left, top, size, size};
  const MapBox exact = part.grid.box();
  std::vector<std::string> words = {"-of", "MEM",
                                    "-wo", "UNIFIED_SRC_NODATA=YES",
                                    "-wm", "64",
                                    "-et", "0.01",
                                    "-r",  step > 1 ? "average" : heights ? "bilinear" : "cubic",
                                    "-te"};
  for (const double edge : {exact.left, exact.bottom, exact.right, exact.top}) words.push_back(CPLSPrintf("%.12g", edge));
  words.emplace_back("-ts");
  for (const int n : {width, height}) words.push_back(std::to_string(n));
  if (!target_.empty()) words.insert(words.end(), {"-t_srs", target_});
  if (heights)
    words.insert(words.end(), {"-ot", "Float64", "-dstnodata", "nan"});
  else
    words.emplace_back("-dstalpha");
  // The wider kernel of reduced scales does not reproduce planes.
  if (heights && step == 1) words.insert(words.end(), {"-wo", "XSCALE=1", "-wo", "YSCALE=1"});
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  const Messages messages;
  GDALWarpAppOptions* options = GDALWarpAppOptionsNew(arguments.data(), nullptr);
  GDALDatasetH source = dataset_.get();
  int usage_error = 0;
  part.warped.reset(options ? GDALWarp("", nullptr, 1, &source, options, &usage_error) : nullptr);
  if (options) GDALWarpAppOptionsFree(options);
  if (!part.warped) throw Error(ErrorCode::io, "cannot read " + path_ + ": it is damaged or truncated" + messages.why());
  part.dataset = part.warped.get();
  return part;
}

void read_rows(const std::string& path, GDALRasterBandH band, const Raster::Part& part, int row, int rows, void* out,
               GDALDataType type, int pixel_bytes) {
  const Messages messages;
  GDALRasterIOExtraArg extra;
  INIT_RASTERIO_EXTRA_ARG(extra);
  extra.eResampleAlg = part.step > 1 ? GRIORA_Average : GRIORA_NearestNeighbour;
  const int s = part.step, width = part.grid.width, first = part.y + row * s;
  if (GDALRasterIOEx(band, GF_Read, part.x, first, width * s, rows * s, out, width, rows, type, pixel_bytes,
                     static_cast<GSpacing>(pixel_bytes) * width, &extra) != CE_None)
    throw Error(ErrorCode::io, "cannot read " + path + ": rows " + std::to_string(first) + " to " +
                                   std::to_string(first + rows * s - 1) + " are damaged or the file is truncated" +
                                   messages.why());
}

}  // namespace iclk::internal
