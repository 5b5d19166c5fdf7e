// GeoTIFF files made here, and what becomes of them.
#include <gtest/gtest.h>

#include <iclk/render/geotiff.h>
#include <iclk/render/internal/raster.h>
#include <iclk/render/renderer.h>

#include "device.h"
#include "files.h"
#include "geotiff_file.h"
#include "render_fixture.h"

namespace iclk {
namespace {

using internal::System;
using test::expect_error;
using test::Folder;
using test::GeoTiff;

const Grid kPicture{40, 30, 2600000, 1200030, 1, 1};    // x 2600000 to 2600040, y 1200000 to 1200030
const Grid kHeights{12, 10, 2599999, 1200033, 4, 3.5};  // coarser, beyond it on all sides

GeoTiff picture() {
  GeoTiff file{kPicture, {}, GDT_Byte, 2056};
  // West dark, east bright; south green.
  file.band([](double x, double) { return x < 2600020 ? 40 : 200; });
  file.band([](double, double y) { return y < 1200015 ? 220 : 30; });
  file.band([](double, double) { return 90; });
  return file;
}

GeoTiff heights() {
  GeoTiff file{kHeights, {}, GDT_Float32, 2056};
  file.band([](double x, double y) { return 400 + 0.5 * (x - 2600000) - 0.25 * (y - 1200000); });
  return file;
}

class GeoTiffs : public ::testing::Test {
 protected:
  std::string mosaic(const GeoTiff& file) const { return file.write(folder_.path("rgb.tif")), folder_.path("rgb.tif"); }
  std::string elevation(const GeoTiff& file) const { return file.write(folder_.path("dem.tif")), folder_.path("dem.tif"); }
  void refused(const GeoTiff& a, const GeoTiff& b, std::initializer_list<const char*> pieces,
               ErrorCode code = ErrorCode::invalid_argument) const {
    const std::string rgb = mosaic(a), dem = elevation(b);
    expect_error([&] { GeoMap(rgb, dem).whole(); }, code, pieces);
  }
  Folder folder_;
};

TEST_F(GeoTiffs, DifferentGridsInProjectedMetres) {
  const Terrain terrain = GeoMap(mosaic(picture()), elevation(heights())).whole();
  EXPECT_EQ(terrain.mosaic.box().text(), "x 2600000 to 2600040, y 1200000 to 1200030");
  EXPECT_EQ(terrain.relief.width, 12);
  EXPECT_EQ(terrain.relief.step_y, 3.5);
  for (const auto& [x, y] : {std::pair(2600010.0, 1200010.0), {2600031.7, 1200003.2}})
    EXPECT_NEAR(terrain.height_at(x, y).value(), 400 + 0.5 * (x - 2600000) - 0.25 * (y - 1200000), 1e-4);
  EXPECT_FALSE(terrain.height_at(2599999.5, 1200010)) << "outside the outermost centres";
  EXPECT_EQ(terrain.rgba[0], test::rgb(40, 30, 90));  // north-west
  EXPECT_EQ(terrain.rgba[39], test::rgb(200, 30, 90));
  EXPECT_EQ(terrain.rgba[29 * 40], test::rgb(40, 220, 90));
}

TEST_F(GeoTiffs, ArePutWhereTheyLieWhenRendered) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<Terrain>(GeoMap(mosaic(picture()), elevation(heights())).whole());
  TerrainRenderer renderer(test::device(), terrain);
  const Camera camera{40, 40, 19.5, 14.5, 40, 30};
  const Eigen::Vector3d C(2600020, 1200015, 446.25);  // 40 m above the ground there
  const View view = renderer.render(camera, test::looking_down(C));
  EXPECT_EQ(view.rgba[6 * 40 + 8], test::rgb(40, 30, 90));
  EXPECT_EQ(view.rgba[6 * 40 + 32], test::rgb(200, 30, 90));
  EXPECT_EQ(view.rgba[25 * 40 + 8], test::rgb(40, 220, 90));
  EXPECT_EQ(view.rgba[25 * 40 + 32], test::rgb(200, 220, 90));
  EXPECT_LT(view.depth[14 * 40 + 30], view.depth[14 * 40 + 10]) << "the ground rises to the east";
  EXPECT_LT(view.depth[25 * 40 + 20], view.depth[5 * 40 + 20]) << "and to the south";
  const Eigen::Vector3d d = camera.ray({30, 8});
  const double z = 40 / (1 + 0.5 * d.x() - 0.25 * -d.y());
  EXPECT_NEAR(view.depth[8 * 40 + 30], z, 1e-4 * z);
}

TEST_F(GeoTiffs, AHeightSystemBesideTheProjectionIsNoOther) {
  GeoTiff dem = heights();
  dem.compound = "EPSG:2056+5728";  // with Swiss heights
  EXPECT_EQ(GeoMap(mosaic(picture()), elevation(dem)).whole().relief.width, 12);
  dem.compound = "EPSG:2056+6360";  // with heights in feet
  refused(picture(), dem, {"dem.tif", "heights", "0.3048"});
}

TEST_F(GeoTiffs, PixelIsPointMeansTheSameAsArea) {
  GeoTiff points = heights();
  points.point = true;
  const Terrain terrain = GeoMap(mosaic(picture()), elevation(points)).whole();
  EXPECT_EQ(terrain.relief.left, kHeights.left);
  EXPECT_EQ(terrain.relief.top, kHeights.top);
}

TEST_F(GeoTiffs, NoDataOfEveryKind) {
  GeoTiff dem = heights();
  dem.bands[0][13] = -9999;
  dem.nodata = "-9999";
  dem.bands[0][27] = NAN;
  GeoTiff rgb = picture();
  rgb.mask.assign(1200, 255);
  rgb.mask[5] = 0;
  Terrain terrain = GeoMap(mosaic(rgb), elevation(dem)).whole();
  EXPECT_TRUE(std::isnan(terrain.height[13]));
  EXPECT_TRUE(std::isnan(terrain.height[27]));
  EXPECT_FALSE(std::isnan(terrain.height[14]));
  EXPECT_EQ(terrain.rgba[5], 0u);
  EXPECT_NE(terrain.rgba[6], 0u);
  // A value for no data means it only where every band has it.
  rgb = picture();
  rgb.nodata = "0";
  for (auto& band : rgb.bands) band[7] = 0;
  rgb.bands[0][8] = 0;
  terrain = GeoMap(mosaic(rgb), elevation(heights())).whole();
  EXPECT_EQ(terrain.rgba[7], 0u);
  EXPECT_EQ(terrain.rgba[8], test::rgb(0, 30, 90));
}

TEST_F(GeoTiffs, IntegersWithScaleAndGreyMosaics) {
  GeoTiff dem = heights();
  dem.type = GDT_Int16;
  for (double& h : dem.bands[0]) h = std::round(10 * (h - 300));
  dem.scale = 0.1, dem.offset = 300;
  GeoTiff grey = picture();
  grey.bands.resize(1);
  const Terrain terrain = GeoMap(mosaic(grey), elevation(dem)).whole();
  EXPECT_NEAR(terrain.height_at(2600010, 1200010).value(), 402.5, 0.06);
  EXPECT_EQ(terrain.rgba[0], test::rgb(40, 40, 40));
}

TEST_F(GeoTiffs, WhatCannotBeUsedIsRefusedWithTheRemedy) {
  const GeoTiff rgb = picture(), dem = heights();
  GeoTiff bad = dem;
  bad.georeferenced = false;
  bad.epsg = 0;
  refused(rgb, bad, {"dem.tif", "no georeference", "-a_ullr"});
  bad = dem;
  bad.grid.left += 1000;
  refused(rgb, bad, {"overlap", "x 2600000 to 2600040", "x 2600999 to 2601047"});
  bad = dem;
  bad.bands[0][3] = -32768;
  refused(rgb, bad, {"dem.tif", "-32768", "-a_nodata"});
  bad = dem;
  bad.unit = "ft";
  refused(rgb, bad, {"dem.tif", "'ft'"});
  refused(rgb, rgb, {"dem.tif", "3 bands"}, ErrorCode::unsupported);
  bad = rgb;
  bad.type = GDT_UInt16;
  refused(bad, dem, {"rgb.tif", "UInt16", "-scale"}, ErrorCode::unsupported);
  bad = rgb;
  bad.bands.resize(1);
  bad.palette = true;
  refused(bad, dem, {"rgb.tif", "palette", "-expand"}, ErrorCode::unsupported);
  bad = GeoTiff{{500000, 500000, 2600000, 1200030, 1, 1}, {}, GDT_Byte, 2056};  // sparse: a small file
  refused(bad, dem, {"rgb.tif", "500000x500000", "MiB"}, ErrorCode::unsupported);
}

TEST_F(GeoTiffs, FilesThatAreNone) {
  const std::string rgb = mosaic(picture()), dem = elevation(heights());
  expect_error([&] { GeoMap(folder_.path("nowhere.tif"), dem).whole(); }, ErrorCode::io, {"nowhere.tif"});
  expect_error([&] { GeoMap(folder_.write("text.tif", "hello"), dem).whole(); }, ErrorCode::io, {"text.tif"});
  expect_error([&] { GeoMap(rgb, folder_.write("empty.tif", "")).whole(); }, ErrorCode::io, {"empty.tif"});
  const std::string whole = test::bytes_of(dem);
  for (const size_t length : {whole.size() / 2, whole.size() - 40, size_t{60}, size_t{8}})
    expect_error([&] { GeoMap(rgb, folder_.write("cut.tif", whole.substr(0, length))).whole(); }, ErrorCode::io, {"cut.tif"});
}

/// The mosaic's pixel and the height at a latitude and longitude.
std::pair<uint32_t, double> seen(const Terrain& terrain, const MapSystem& system, double latitude, double longitude) {
  const Eigen::Vector2d at = system.place(latitude, longitude).value();
  const Eigen::Vector2d pixel = terrain.mosaic.pixel(at.x(), at.y());
  const auto u = static_cast<size_t>(std::lround(pixel.x())), v = static_cast<size_t>(std::lround(pixel.y()));
  return {terrain.rgba.at(v * static_cast<size_t>(terrain.mosaic.width) + u),
          terrain.height_at(at.x(), at.y()).value_or(std::nan(""))};
}

/// A raster near 46 N 7.5 E in the system `epsg`: values are functions of latitude and longitude.
GeoTiff placed(int epsg, double metres, bool heights) {
  const System earth(OSRNewSpatialReference(nullptr)), own(OSRNewSpatialReference(nullptr));
  OSRImportFromEPSG(earth.get(), 4326), OSRImportFromEPSG(own.get(), epsg);
  for (const auto& system : {earth.get(), own.get()}) OSRSetAxisMappingStrategy(system, OAMS_TRADITIONAL_GIS_ORDER);
  const auto to_own = OCTNewCoordinateTransformation(earth.get(), own.get()),
             to_earth = OCTNewCoordinateTransformation(own.get(), earth.get());
  double x = 7.5, y = 46, z = 0;
  OCTTransform(to_own, 1, &x, &y, &z);
  const double unit = OSRIsGeographic(own.get()) ? 1 / 111000.0 : epsg == 3857 ? 1 / std::cos(46 * M_PI / 180) : 1;
  const double step = metres * unit, side = heights ? 260 : 200;
  const int count = static_cast<int>(side / metres);
  GeoTiff file{{count, count, x - side / 2 * unit, y + side / 2 * unit, step, step}, {}, GDT_Float64, epsg};
  const auto of = [&](auto&& value) {
    return [=](double u, double v) {
      double w = 0;
      OCTTransform(to_earth, 1, &u, &v, &w);
      return value(v, u);
    };
  };
  if (heights) {
    file.band(of([](double latitude, double longitude) { return 500 + 2e4 * (latitude - 46) + 3e4 * (longitude - 7.5); }));
  } else {
    file.type = GDT_Byte;
    file.band(of([](double latitude, double) { return std::clamp(128 + 1e5 * (latitude - 46), 1.0, 255.0); }));
    file.band(of([](double, double longitude) { return std::clamp(128 + 8e4 * (longitude - 7.5), 1.0, 255.0); }));
    file.band(of([](double, double) { return 90; }));
  }
  OCTDestroyCoordinateTransformation(to_own), OCTDestroyCoordinateTransformation(to_earth);
  return file;
}

TEST_F(GeoTiffs, AnySystemShowsTheSameGround) {
  constexpr int kSystems[] = {2056, 32632, 4326, 3857, 4258};  // Swiss and UTM metres, degrees, Web Mercator, degrees
  for (const int picture_system : kSystems)
    for (const int height_system : kSystems) {
      const GeoMap map(mosaic(placed(picture_system, 1, false)), elevation(placed(height_system, 4, true)));
      SCOPED_TRACE(std::to_string(picture_system) + " and " + std::to_string(height_system) + " in " + map.system().name());
      EXPECT_EQ(map.system().name().find(picture_system == 2056 ? "CH1903+" : "UTM zone 32N") == std::string::npos, false);
      for (const bool all : {true, false}) {
        const Terrain terrain = all ? map.whole() : *map.window(map.extent(), 1);
        for (const auto& [latitude, longitude] : {std::pair(46.0, 7.5), {46.0005, 7.5005}, {45.9994, 7.4993}}) {
          const auto [pixel, height] = seen(terrain, map.system(), latitude, longitude);
          EXPECT_NEAR(pixel & 255, 128 + 1e5 * (latitude - 46), 1.6);
          EXPECT_NEAR(pixel >> 8 & 255, 128 + 8e4 * (longitude - 7.5), 1.6);
          EXPECT_NEAR(height, 500 + 2e4 * (latitude - 46) + 3e4 * (longitude - 7.5), 0.02);
        }
      }
    }
}

TEST_F(GeoTiffs, ATurnedRasterIsStraightened) {
  GeoTiff turned = picture();
  turned.rotation = 0.1;
  const Terrain terrain = GeoMap(mosaic(turned), elevation(heights())).whole();
  EXPECT_GT(terrain.mosaic.width, kPicture.width);
  const auto row = static_cast<size_t>(terrain.mosaic.width);
  EXPECT_EQ(terrain.rgba[2 * row + 2] >> 24, 255u);
  EXPECT_EQ(terrain.rgba[3 * row - 2] >> 24, 0u) << "beyond the end of the turned row";
}

TEST_F(GeoTiffs, WindowsAreCutFromTheWhole) {
  const GeoMap map(mosaic(picture()), elevation(heights()));
  const Terrain whole = map.whole();
  const auto window = map.window({2600015, 1200010, 2600025, 1200020}, 0.1);
  ASSERT_TRUE(window);
  EXPECT_EQ(window->mosaic.width, 10);
  EXPECT_EQ(window->mosaic.box().text(), "x 2600015 to 2600025, y 1200010 to 1200020");
  for (size_t v = 0; v < 10; ++v)
    for (size_t u = 0; u < 10; ++u) EXPECT_EQ(window->rgba[10 * v + u], whole.rgba[40 * (v + 10) + u + 15]);
  EXPECT_EQ(window->height_at(2600020.3, 1200014.1), whole.height_at(2600020.3, 1200014.1));
  EXPECT_FALSE(map.window({0, 0, 10, 10}, 1)) << "not on the map";
}

TEST_F(GeoTiffs, CoarseWindowsAreMeans) {
  const GeoMap map(mosaic(picture()), elevation(heights()));
  const auto window = map.window(map.extent(), 4.1);
  ASSERT_TRUE(window);
  EXPECT_EQ(window->mosaic.step_x, 4);
  EXPECT_EQ(window->rgba[0], test::rgb(40, 30, 90));
  EXPECT_EQ(window->relief.step_y, 3.5);
}

TEST_F(GeoTiffs, WindowsOfAHugeMosaicAreSmall) {
  const GeoTiff huge{{16384, 16384, 2600000, 1200030, 0.1, 0.1}, {{}}, GDT_Byte, 2056};  // sparse: a small file
  GeoTiff dem{{42, 42, 2599980, 1200050, 40, 40}, {}, GDT_Float32, 2056};
  dem.band([](double, double) { return 500; });
  const std::string rgb = folder_.path("huge.tif");
  huge.write(rgb);
  const GeoMap map(rgb, elevation(dem));
  const auto part = map.window({2601000, 1199000, 2601100, 1199100}, 0.1), all = map.window(map.extent(), 0.1);
  ASSERT_TRUE(part && all);
  EXPECT_EQ(part->mosaic.width, 1000);
  EXPECT_LE(all->rgba.size(), size_t{1} << 23);
  EXPECT_EQ(all->mosaic.width, 2048);
}

}  // namespace
}  // namespace iclk
