// GeoTIFF files made here, and what becomes of them.
#include <gtest/gtest.h>

#include <iclk/render/geotiff.h>
#include <iclk/render/renderer.h>

#include "device.h"
#include "files.h"
#include "geotiff_file.h"
#include "render_fixture.h"

namespace iclk {
namespace {

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
    expect_error([&] { load_terrain(rgb, dem); }, code, pieces);
  }
  Folder folder_;
};

TEST_F(GeoTiffs, DifferentGridsInProjectedMetres) {
  const Terrain terrain = load_terrain(mosaic(picture()), elevation(heights()));
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
  const auto terrain = std::make_shared<Terrain>(load_terrain(mosaic(picture()), elevation(heights())));
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
  EXPECT_EQ(load_terrain(mosaic(picture()), elevation(dem)).relief.width, 12);
  dem.compound = "EPSG:2056+6360";  // with heights in feet
  refused(picture(), dem, {"dem.tif", "heights", "0.3048"});
}

TEST_F(GeoTiffs, PixelIsPointMeansTheSameAsArea) {
  GeoTiff points = heights();
  points.point = true;
  const Terrain terrain = load_terrain(mosaic(picture()), elevation(points));
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
  Terrain terrain = load_terrain(mosaic(rgb), elevation(dem));
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
  terrain = load_terrain(mosaic(rgb), elevation(heights()));
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
  const Terrain terrain = load_terrain(mosaic(grey), elevation(dem));
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
  bad.epsg = 4326;
  bad.grid.left = 7, bad.grid.top = 46, bad.grid.step_x = bad.grid.step_y = 1e-4;
  refused(rgb, bad, {"dem.tif", "degrees", "gdalwarp"});
  bad = dem;
  bad.epsg = 3857;
  refused(rgb, bad, {"dem.tif", "Web Mercator", "gdalwarp"});
  bad = dem;
  bad.epsg = 2263;  // New York, feet
  refused(rgb, bad, {"dem.tif", "0.3048", "gdalwarp"});
  bad = dem;
  bad.rotation = 0.1;
  refused(rgb, bad, {"dem.tif", "rotated", "0.1"});
  bad = dem;
  bad.epsg = 32632;
  refused(rgb, bad, {"rgb.tif", "dem.tif", "UTM zone 32N", "gdalwarp"});
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
  expect_error([&] { load_terrain(folder_.path("nowhere.tif"), dem); }, ErrorCode::io, {"nowhere.tif"});
  expect_error([&] { load_terrain(folder_.write("text.tif", "hello"), dem); }, ErrorCode::io, {"text.tif"});
  expect_error([&] { load_terrain(rgb, folder_.write("empty.tif", "")); }, ErrorCode::io, {"empty.tif"});
  const std::string whole = test::bytes_of(dem);
  for (const size_t length : {whole.size() / 2, whole.size() - 40, size_t{60}, size_t{8}})
    expect_error([&] { load_terrain(rgb, folder_.write("cut.tif", whole.substr(0, length))); }, ErrorCode::io, {"cut.tif"});
}

}  // namespace
}  // namespace iclk
