// `iclk render` as a process: sets on the disk, killed and continued; single views; bad input.
#include <opencv2/imgcodecs.hpp>

#include <iclk/session/io/feature_csv.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/sets/pair_set.h"
#include "apps/json/manifest.h"
#include "batch_process.h"
#include "device.h"
#include "full_disk.h"
#include "geotiff_file.h"
#include "render_fixture.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::count_lines;
using test::Folder;
using test::GeoTiff;
using test::Process;
using test::wait_until;
namespace fs = std::filesystem;

std::vector<std::string> pairs(const std::string& out, int count, std::vector<std::string> more = {}) {
  std::vector<std::string> all = {"render", "--terrain", "procedural:3:300", "--altitude",         "60,90", "--size", "188x120",
                                  "--out",  out,         "--pairs",          std::to_string(count)};
  all.insert(all.end(), more.begin(), more.end());
  return all;
}

/// Runs to the end; what it printed.
std::string run(const std::vector<std::string>& arguments, int code = 0) {
  Process process(arguments);
  EXPECT_EQ(process.wait(), code) << process.err();
  return code == 0 ? process.out() : process.err();
}

/// Every file of a set by its name, but for set.json.
std::map<std::string, std::string> files_of(const std::string& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder))
    if (entry.is_regular_file() && entry.path().filename() != "set.json")
      files[fs::relative(entry.path(), folder).string()] = bytes_of(entry.path().string());
  return files;
}

TEST(PairSets, AreWhatBatchReads) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string set = folder.path("set"), said = run(pairs(set, 3));
  for (const char* piece : {"3 pairs of 188x120", "e_pixel", "e_transl", "e_rot"})
    EXPECT_NE(said.find(piece), std::string::npos) << said;
  const Manifest manifest = read_manifest(set + "/pairs.jsonl");
  ASSERT_EQ(manifest.lines.size(), 3u);
  for (const ManifestLine& line : manifest.lines) {
    const PairRequest request = parse_line(manifest, line);
    const cv::Mat image = load_image(request.files.reference), depth = load_depth(request.files.depth, 0);
    EXPECT_EQ(image.size(), cv::Size(188, 120));
    EXPECT_EQ(load_image(request.files.target).size(), cv::Size(188, 120));
    const Features features = load_features(request.files.features);
    ASSERT_EQ(features.size(), 50);
    for (int i = 0; i < features.size(); ++i) {
      const Eigen::Vector2d uv = features.uv[static_cast<size_t>(i)];
      EXPECT_GE(uv.minCoeff(), 17);
      const float z = depth.at<float>(static_cast<int>(uv.y()), static_cast<int>(uv.x()));
      EXPECT_NEAR(1 / features.inverse_depth[static_cast<size_t>(i)], z, 1e-6 * z);
    }
    ASSERT_TRUE(request.truth);
    const auto start = request.meta["start"];
    EXPECT_NEAR(start["e_transl"].get<double>(), request.truth->t.norm(), 1e-12);
    const Camera camera{455.0 * 188 / 752, 455.0 * 188 / 752, 93.5, 59.5, 188, 120};
    EXPECT_NEAR(start["e_pixel"].get<double>(), pose_error(camera, features, SE3(), *request.truth).e_pixel, 1e-4);
  }
  run({"batch", set + "/pairs.jsonl", "--solver", "cpu", "--out", folder.path("results.jsonl")});
  int converged = 0;
  for (const auto& [id, result] : test::results_of(folder.path("results.jsonl")))
    if (result["status"] == "converged" && result["errors"]["e_pixel"] < 0.5) ++converged;
  EXPECT_GE(converged, 2) << "the truth is the truth";
}

TEST(PairSets, DepthOfTheTargetIsWhatCameraOneSees) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  run(pairs(folder.path("set"), 2, {"--target-depth"}));
  const Manifest manifest = read_manifest(folder.path("set/pairs.jsonl"));
  ASSERT_EQ(manifest.lines.size(), 2u);
  for (const ManifestLine& line : manifest.lines) {
    const PairRequest request = parse_line(manifest, line);
    const cv::Mat depth = load_depth(folder.path("set/" + request.meta["target_depth"].get<std::string>()), 0);
    const Features features = load_features(request.files.features);
    const Camera camera{455.0 * 188 / 752, 455.0 * 188 / 752, 93.5, 59.5, 188, 120};
    int seen = 0, agreed = 0;
    for (size_t i = 0; i < features.uv.size(); ++i) {
      const Eigen::Vector3d X = *request.truth * (camera.ray(features.uv[i]) / features.inverse_depth[i]);
      const Eigen::Vector2d uv = camera.project(X);
      if (uv.minCoeff() < 0 || uv.x() > 187 || uv.y() > 119) continue;
      ++seen;
      const float z = depth.at<float>(static_cast<int>(std::lround(uv.y())), static_cast<int>(std::lround(uv.x())));
      agreed += std::abs(z - X.z()) < 0.005 * X.z();  // another point of the pixel, or what hides this one
    }
    EXPECT_GT(seen, 25);
    EXPECT_GT(agreed, 0.8 * seen);
  }
}

TEST(PairSets, GoOnAfterAKillAsIfNothingHadHappened) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string whole = folder.path("whole"), killed = folder.path("killed");
  run(pairs(whole, 14));
  for (const int lines : {2, 6}) {
    Process process(pairs(killed, 14));
    ASSERT_TRUE(test::wait_until([&] { return count_lines(killed + "/pairs.jsonl") >= lines || process.ended(); }));
    process.signal(SIGKILL);
    process.wait();
    ASSERT_LT(count_lines(killed + "/pairs.jsonl"), 14) << "killed too late to test anything";
  }
  // As a kill in the midst of a line and of a file would leave them.
  std::ofstream(killed + "/pairs.jsonl", std::ios::app) << R"({"id":"000013","refer)";
  std::ofstream(killed + "/images/000013_0.png.part99") << "half";
  run(pairs(killed, 14));
  EXPECT_EQ(files_of(killed), files_of(whole));
  EXPECT_EQ(count_lines(whole + "/pairs.jsonl"), 14);
  // Once more: nothing to do. And more pairs than at first.
  const std::string before = bytes_of(killed + "/pairs.jsonl");
  EXPECT_NE(run(pairs(killed, 14)).find("0 rendered"), std::string::npos);
  EXPECT_EQ(bytes_of(killed + "/pairs.jsonl"), before);
  run(pairs(killed, 15));
  EXPECT_TRUE(bytes_of(killed + "/pairs.jsonl").starts_with(before));
  EXPECT_EQ(count_lines(killed + "/pairs.jsonl"), 15);
}

TEST(PairSets, OrbitsGoOnAsTheyBegan) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::vector<std::string> orbit = {"--orbit", "5,20", "--start", "8,60", "--altitude", "30,40"};
  const auto orbits = [&](const char* name, int count, std::vector<std::string> more) {
    more.insert(more.begin(), {"render", "--terrain", "procedural:3:300", "--size", "188x120", "--out", folder.path(name)});
    more.insert(more.end(), {"--pairs", std::to_string(count)});
    return more;
  };
  run(orbits("at once", 3, orbit));
  run(orbits("longer", 1, orbit)), run(orbits("longer", 3, orbit));
  EXPECT_EQ(files_of(folder.path("at once")), files_of(folder.path("longer")));
  EXPECT_NE(bytes_of(folder.path("longer") + "/set.json").find("\"orbit\": \"5,20\""), std::string::npos);
  std::vector<std::string> other = orbit;
  other[1] = "5,30";
  EXPECT_NE(run(orbits("longer", 4, other), kBadInput).find("orbit"), std::string::npos);
}

TEST(PairSets, OtherOptionsAndOtherFoldersAreRefused) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string set = folder.path("set");
  run(pairs(set, 1));
  const auto before = files_of(set);
  const auto refused = [&](const std::vector<std::string>& arguments, int code, std::initializer_list<const char*> pieces) {
    const std::string said = run(arguments, code);
    for (const char* piece : pieces) EXPECT_NE(said.find(piece), std::string::npos) << "'" << piece << "' in: " << said;
    EXPECT_EQ(files_of(set), before);
  };
  refused(pairs(set, 2, {"--seed", "1"}), kBadInput, {"set.json", "seed", "0", "now it is 1", "--out"});
  refused(pairs(set, 2, {"--tilt", "10"}), kBadInput, {"tilt 15", "now it is 10"});
  refused(pairs(set, 2, {"--region", "0,0,0.9,1"}), kBadInput, {"region"});
  std::vector<std::string> other = pairs(set, 2);
  other[2] = "procedural:4:240";
  refused(other, kBadInput, {"terrain"});
  folder.write("mine/thesis.txt", "x");
  refused(pairs(folder.path("mine"), 1), kBadInput, {"thesis.txt", "empty"});
  EXPECT_EQ(bytes_of(folder.path("mine/thesis.txt")), "x");
  folder.write("broken/set.json", "{");
  refused(pairs(folder.path("broken"), 1), kBadInput, {"set.json", "damaged"});
  folder.write("deep/set.json", "{\"options\":" + std::string(100000, '[') + std::string(100000, ']') + "}");
  refused(pairs(folder.path("deep"), 1), kBadInput, {"set.json", "100 levels"});
  std::ofstream(set + "/pairs.jsonl", std::ios::app) << "{}\n";
  const std::string said = run(pairs(set, 2), kBadInput);
  EXPECT_NE(said.find("pairs.jsonl:2"), std::string::npos) << said;
}

TEST(PairSets, AFullDiskIsSaidAndTheSetGoesOn) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string set = folder.path("set");
  if (!test::can_fill_disk) GTEST_SKIP() << "nothing can be preloaded beside AddressSanitizer";
  // The images of the first pairs have room, those of another have not: four operations a file.
  Process full(pairs(set, 500), [&] { test::fill_disk(set + "/images", 1 + 3 * 8 + 2); });
  EXPECT_EQ(full.wait(), kIo) << full.err();
  const int whole = count_lines(set + "/pairs.jsonl");
  EXPECT_EQ(whole, 3);
  char next[16];
  std::snprintf(next, sizeof next, "/%06d_", whole);
  EXPECT_NE(full.err().find("cannot write " + set + "/images" + next), std::string::npos) << full.err();
  for (const auto& entry : fs::directory_iterator(set + "/images")) {
    EXPECT_EQ(entry.path().extension(), ".png") << entry.path();
    EXPECT_NO_THROW(load_image(entry.path().string()));
  }
  run(pairs(set, whole + 1));
  EXPECT_EQ(count_lines(set + "/pairs.jsonl"), whole + 1);
}

/// A plane of 200 x 200 m in two GeoTIFF files.
void write_plane(const Folder& folder, bool georeferenced = true) {
  GeoTiff rgb{{200, 200, 1000, 5200, 1, 1}, {}, GDT_Byte}, dem{{50, 50, 1000, 5200, 4, 4}, {}, GDT_Float32};
  rgb.georeferenced = georeferenced;
  for (int c = 0; c < 3; ++c) rgb.band([&](double x, double y) { return 128 + 100 * std::sin(x / (3 + c)) * std::cos(y / 4); });
  dem.band([](double, double) { return 50; });
  rgb.write(folder.path("rgb.tif"));
  dem.write(folder.path("dem.tif"));
}

TEST(RenderedViews, OfGeoTiffs) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  write_plane(folder);
  const std::string out = folder.path("view");
  const std::vector<std::string> arguments = {
      "render", "--ortho", folder.path("rgb.tif"),  "--elevation", folder.path("dem.tif"), "--size",
      "120x80", "--pose",  "1100 5100 130 1 0 0 0", "--camera",    "100,100,59.5,39.5",    "--out",
      out};
  EXPECT_NE(run(arguments).find("100.0 %"), std::string::npos);
  const cv::Mat depth = load_depth(out + "/depth.tiff", 0), image = load_image(out + "/view.png");
  EXPECT_EQ(depth.size(), cv::Size(120, 80));
  EXPECT_NEAR(depth.at<float>(10, 100), 80, 1e-4);
  // Pixel (u, v) sees x = 1100 + 0.8 (u - 59.5), y = 5100 - 0.8 (v - 39.5); files are BGR to OpenCV.
  const double x = 1100 + 0.8 * (90 - 59.5), y = 5100 - 0.8 * (20 - 39.5);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(image.at<cv::Vec3b>(20, 90)[2 - c], 128 + 100 * std::sin(x / (3 + c)) * std::cos(y / 4), 8) << c;
}

TEST(PairSets, OfTwoDates) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string set = folder.path("set");
  run(pairs(set, 1, {"--date", "summer", "--target-date", "winter:1:200,20"}));
  run(pairs(folder.path("summer"), 1, {"--date", "summer"}));
  run(pairs(folder.path("winter"), 1, {"--date", "winter:1:200,20"}));
  auto files = files_of(set), summer = files_of(folder.path("summer")), winter = files_of(folder.path("winter"));
  for (const char* file : {"images/000000_0.png", "depth/000000.tiff", "pairs.jsonl", "features/000000.csv"})
    EXPECT_EQ(files[file], summer[file]) << file;
  EXPECT_EQ(files["images/000000_1.png"], winter["images/000000_1.png"]);
  EXPECT_NE(files["images/000000_1.png"], summer["images/000000_1.png"]);
  const std::string said = run(pairs(set, 2, {"--date", "summer", "--target-date", "winter:2:200,20"}), kBadInput);
  EXPECT_NE(said.find("target_terrain"), std::string::npos) << said;
  EXPECT_NE(run(pairs(set, 2, {"--date", "summer"}), kBadInput).find("target_terrain"), std::string::npos);
}

TEST(PairSets, OfTwoOrthomosaics) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  write_plane(folder);
  GeoTiff later{{200, 200, 1000, 5200, 1, 1}, {}, GDT_Byte};
  for (int c = 0; c < 3; ++c) later.band([](double, double) { return 33; });
  later.write(folder.path("later.tif"));
  run({"render", "--ortho", folder.path("rgb.tif"), "--elevation", folder.path("dem.tif"), "--target-ortho",
       folder.path("later.tif"), "--pairs", "1", "--altitude", "60,70", "--size", "94x60", "--out", folder.path("set")});
  cv::Scalar mean, deviation;
  cv::meanStdDev(load_image(folder.path("set/images/000000_1.png")), mean, deviation);
  EXPECT_EQ(mean[0], 33);
  EXPECT_EQ(deviation[0], 0);
  cv::meanStdDev(load_image(folder.path("set/images/000000_0.png")), mean, deviation);
  EXPECT_GT(deviation[0], 20);
}

TEST(RenderedViews, BadInputHasItsCodeAndNamesTheValue) {
  const Folder folder;
  write_plane(folder);
  const std::string rgb = folder.path("rgb.tif"), dem = folder.path("dem.tif"), out = folder.path("out");
  const std::string down = "1100 5100 130 1 0 0 0";
  const auto expect = [&](std::vector<std::string> options, int code, std::initializer_list<const char*> pieces) {
    options.insert(options.begin(), {"render", "--out", out});
    const std::string said = run(options, code);
    for (const char* piece : pieces) EXPECT_NE(said.find(piece), std::string::npos) << "'" << piece << "' in: " << said;
  };
  expect({"--pose", down, "--ortho", rgb}, kBadInput, {"--elevation", "procedural"});
  expect({"--pairs", "1", "--terrain", "moon"}, kBadInput, {"moon", "procedural:SEED"});
  expect({"--pairs", "1", "--terrain", "procedural:x"}, kBadInput, {"procedural:x"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--ortho", rgb}, kBadInput, {"--ortho"});
  expect({"--pairs", "1", "--terrain", "procedural:1:2"}, kBadInput, {"2.0"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--region", "0,0,1"}, kBadInput, {"--region", "4 numbers"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--region", "0.5,0,0.4,1"}, kBadInput, {"0.5,0,0.4,1"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--altitude", "9,x"}, kBadInput, {"--altitude", "'x'"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--orbit", "10"}, kBadInput, {"--orbit", "2 numbers"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--orbit", "0,0"}, kBadInput, {"--orbit 0,0", "above 0"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--orbit", "30,10"}, kBadInput, {"30 to 10 degrees"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--start", "9,9"}, kBadInput, {"9 to 9 px"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--orbit", "9,9", "--translation", "2"}, kUsage, {"--translation"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--samples", "0"}, kBadInput, {"samples 0"});
  const auto date = [&](const char* text) {
    return std::vector<std::string>{"--pairs", "1", "--terrain", "procedural:1:300", "--date", text};
  };
  for (const char* text :
       {"june", "winter:x", "winter:1:2", "winter:1:2,3,4", "winter:1:90,3", "winter:1:90,nan", "a:b:c:d", ":"})
    expect(date(text), kUsage, {"--date"});
  expect({"--pairs", "1", "--ortho", rgb, "--elevation", rgb, "--date", "snow"}, kUsage, {"--date", "--terrain"});
  expect({"--pairs", "1", "--terrain", "procedural:1", "--target-date", "snow"}, kUsage, {"--target-date", "--date"});
  expect({"--pose", down, "--terrain", "procedural:1", "--date", "snow", "--target-date", "snow"}, kUsage, {"--pairs"});
  expect({"--terrain", "procedural:1"}, kUsage, {});
  expect({"--pairs", "1", "--pose", down, "--terrain", "procedural:1"}, kUsage, {});
  expect({"--pairs", "0", "--terrain", "procedural:1"}, kUsage, {"--pairs"});
  if (!test::device()) return;
  expect({"--pose", down, "--ortho", folder.path("no.tif"), "--elevation", dem}, kIo, {"no.tif"});
  expect({"--pose", down, "--ortho", rgb, "--elevation", folder.write("cut.tif", bytes_of(dem).substr(0, 5000))}, kIo,
         {"cut.tif"});
  expect({"--pose", "1100 5100 30 1 0 0 0", "--ortho", rgb, "--elevation", dem}, kBadInput, {"30", "50", "above"});
  expect({"--pose", "1100 5100 130 1 1 0 0", "--ortho", rgb, "--elevation", dem}, kBadInput, {"--pose"});
  expect({"--pairs", "1", "--ortho", rgb, "--elevation", dem, "--altitude", "500,600"}, kBadInput, {"no room", "196"});
  write_plane(folder, false);
  expect({"--pose", down, "--ortho", rgb, "--elevation", dem}, kBadInput, {"rgb.tif", "-a_ullr"});
}

}  // namespace
}  // namespace iclk
