// iclk locate as a user runs it, on GeoTIFF files made here.
#include <iostream>

#include <nlohmann/json.hpp>

#include <iclk/locate/sequence_locator.h>
#include <iclk/session/device.h>
#include <iclk/session/io/distortion.h>

#include "locate_fixture.h"

namespace iclk::test {
namespace {

TEST_F(Locate, FindsPicturesAndWritesWhatItSays) {
  const Folder folder;
  std::string out;
  for (const char* header : {"image,lat,lon,z,yaw,pitch,roll", "image,x,y,z,omega,phi,kappa"}) {
    out = folder.path(header);
    const Finished f = locate(priors(folder, header), out);
    ASSERT_EQ(f.code, 0) << f.err;
    EXPECT_NE(f.out.find("located    3 of 3"), std::string::npos) << f.out;
    const auto poses = load_trajectory(out + "/trajectory.txt");
    ASSERT_EQ(poses.size(), 3u);
    for (size_t i = 0; i < 3; ++i) EXPECT_LT((poses[i].T_wc.t - truth_[i].t).norm(), 0.1);
  }
  expect_lines_of("located-1.json", out + "/located.jsonl");
  const auto first = nlohmann::json::parse(lines_of(bytes_of(out + "/located.jsonl")).front());
  EXPECT_NEAR(first.at("lat_lon").at(0).get<double>(), 47.85, 0.01);
  EXPECT_NEAR(first.at("lat_lon").at(1).get<double>(), 15.0, 0.01);
  const std::string csv = bytes_of(out + "/located.csv");
  const auto table = lines_of(csv);
  ASSERT_GE(table.size(), 4u);
  const auto head = split_cells(table[0]), row = split_cells(table[1]);
  ASSERT_EQ(row.size(), head.size());
  const auto cell = [&](const char* column) {
    return to_number(row[static_cast<size_t>(std::find(head.begin(), head.end(), column) - head.begin())]).value();
  };
  EXPECT_NEAR(cell("y"), truth_[0].t.y(), 0.1);
  EXPECT_NEAR(cell("lat"), first.at("lat_lon").at(0).get<double>(), 1e-8);
  EXPECT_NEAR(cell("kappa"), first.at("omega_phi_kappa").at(2).get<double>(), 1e-4);
  EXPECT_NEAR(cell("sigma_z"), first.at("sigma").at("position").at(2).get<double>(), 1e-3 * cell("sigma_z"));
  EXPECT_EQ(cell("inliers"), first.at("inliers").get<double>());
  const auto map = nlohmann::json::parse(bytes_of(out + "/located.geojson"));
  ASSERT_EQ(map.at("features").size(), 6u) << "a point and a footprint per picture";
  EXPECT_NEAR(map.at("features").at(0).at("geometry").at("coordinates").at(0).get<double>(), 15.0, 0.01);
  EXPECT_FALSE(cv::imread(out + "/overlay/2.png").empty());
}

TEST_F(Locate, PicturesThatAreNotFoundAreNotClaimed) {
  const Folder folder;
  std::filesystem::create_directories(folder.path("noise"));
  cv::Mat noise(240, 320, CV_8UC3);
  cv::RNG(1).fill(noise, cv::RNG::UNIFORM, 0, 255);
  cv::imwrite(folder.path("noise/0.png"), noise);
  const Finished f = run({"locate", folder.path("noise"), "--ortho", folder_->path("ortho.tif"), "--elevation",
                          folder_->path("dem.tif"), "--camera", "300,300,159.5,119.5", "--prior",
                          priors(folder, "image,x,y,z,yaw,pitch,roll"), "--prior-sigma", "2,2", "--out", folder.path("out")});
  EXPECT_EQ(f.code, 14) << f.out << f.err;
  expect_lines_of("located-1.json", folder.path("out/located.jsonl"));
  EXPECT_EQ(bytes_of(folder.path("out/trajectory.txt")).find("\n0"), std::string::npos);
  const std::string csv = bytes_of(folder.path("out/located.csv"));
  const auto table = lines_of(csv);
  ASSERT_GE(table.size(), 2u);
  EXPECT_EQ(split_cells(table[1]).size(), split_cells(table[0]).size()) << table[1];
}

TEST_F(Locate, PixelsLieOnTheGround) {
  const Folder folder;
  // A picture with a lens: what the pinhole sees at its pixels, the camera has elsewhere.
  const std::string lens = "radtan:-0.1,0.02,0.001,-0.001,0";
  TerrainRenderer renderer(device(), terrain_, {.samples = 3});
  const View view = renderer.render(kCamera, truth_[0], Lens(parse_distortion(lens)));
  cv::Mat bgr;
  cv::cvtColor(cv::Mat(240, 320, CV_8UC4, const_cast<uint32_t*>(view.rgba.data())), bgr, cv::COLOR_RGBA2BGR);
  std::filesystem::create_directories(folder.path("frames"));
  cv::imwrite(folder.path("frames/0.png"), bgr);
  const std::vector<cv::Point> pixels = {{160, 120}, {20, 30}, {300, 200}};
  std::string csv = "u,image,v\n";
  for (const cv::Point& p : pixels) csv += fmt::format("{},dir/0.png,{}\n", p.x, p.y);
  const std::string out = folder.path("out"), asked = folder.write("pixels.csv", csv + "5000,0.png,3\n9,other.png,9\n");
  const auto ask = [&](const std::string& file) {
    return locate_on_map(folder.path("frames"), out,
                         {"--camera", "300,300,159.5,119.5", "--distortion", lens, "--prior-sigma", "4,3", "--prior",
                          priors(folder, "image,x,y,z,yaw,pitch,roll"), "--pixels", file, "--elevation-sigma", "0.5"});
  };
  const Finished f = ask(asked);
  ASSERT_EQ(f.code, 0) << f.out << f.err;
  EXPECT_NE(f.out.find("ground     3 of 5 pixels"), std::string::npos) << f.out;
  const std::string table = bytes_of(out + "/ground.csv");
  const auto lines = lines_of(table);
  ASSERT_GE(lines.size(), 6u);
  for (size_t i = 0; i < pixels.size(); ++i) {
    const auto cells = split_cells(lines[i + 1]);
    ASSERT_EQ(cells.size(), 12u) << lines[i + 1];
    const auto& p = pixels[i];
    const double z = view.depth[static_cast<size_t>(p.y) * 320 + static_cast<size_t>(p.x)];
    const Eigen::Vector3d ray = kCamera.ray(*pinhole_pixel(kCamera, Lens(parse_distortion(lens)), {p.x, p.y}));
    const Eigen::Vector3d X = truth_[0] * Eigen::Vector3d(z * ray);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(*to_number(cells[static_cast<size_t>(5 + k)]), X[k], 0.3) << lines[i + 1];
    EXPECT_GT(*to_number(cells[11]), 0.2);
    EXPECT_GE(*to_number(cells[8]), *to_number(cells[9]));
  }
  EXPECT_EQ(lines[4], "0.png,5000,3,,,,,,,,,");
  EXPECT_EQ(ask(folder.write("x.csv", "image,u\n0.png,1\n")).code, 3);
  const Finished bad = ask(folder.write("y.csv", "image,u,v\n0.png,1,two\n"));
  EXPECT_NE(bad.err.find("y.csv:2:"), std::string::npos) << bad.err;
  EXPECT_EQ(ask(folder.write("z.csv", "image,u,v\nother.png,1,2\n")).code, 3);
}

TEST_F(Locate, BadInputIsSaid) {
  const Folder folder;
  const auto refused = [&](const std::string& csv, const std::string& word, int code = 3) {
    const Finished f = locate(folder.write("bad.csv", csv), folder.path("out"));
    EXPECT_EQ(f.code, code) << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << word << ": " << f.err;
    EXPECT_FALSE(std::filesystem::exists(folder.path("out/located.jsonl")));
  };
  const std::string header = "image,x,y,z,yaw,pitch,roll\n";
  refused("image,x,y,z\n0.png,1,2,3\n", "yaw,pitch,roll");
  refused("image,x,y,z,lat,lon,yaw,pitch,roll\n", "either");
  refused(header, "no pose");
  refused(header + "0.png,1,2,three,0,-90,0\n", "bad.csv:2: 'three'");
  refused(header + "0.png,1,2,3,0,-90\n", "bad.csv:2");
  refused(header + "other.png,500100,5300100,500,0,-90,0\n", "0.png");
  refused(header + "0.png,100,200,500,0,-90,0\n", "same system");
  refused("image,lat,lon,z,yaw,pitch,roll\n0.png,95,15,500,0,-90,0\n", "latitude 95");
  refused(header + "a/0.png,1,2,3,0,-90,0\nb/0.png,1,2,3,0,-90,0\n", "bad.csv:3: a second pose");
  EXPECT_EQ(locate(folder.path("none.csv"), folder.path("out")).code, 4);
  std::filesystem::create_directories(folder.path("more"));
  std::filesystem::copy(folder_->path("frames/0.png"), folder.path("more/0.png"));
  const std::string good = priors(folder, "image,x,y,z,yaw,pitch,roll");
  const Finished twice = locate(good, folder.path("out"), {folder.path("more")});
  EXPECT_EQ(twice.code, 3) << twice.out;
  EXPECT_NE(twice.err.find("the same name"), std::string::npos) << twice.err;
  EXPECT_EQ(locate(good, folder.path("out"), {"--heading-sigma", "-1"}).code, 3);
}

TEST(Attitudes, AreWhatTheirNamesSay) {
  const auto is = [](const Eigen::Vector3d& a, double x, double y, double z) {
    EXPECT_LT((a - Eigen::Vector3d(x, y, z)).norm(), 1e-9);
  };
  const Eigen::Matrix3d ahead = from_yaw_pitch_roll({90, 0, 0});  // east, level
  is(ahead.col(2), 1, 0, 0);
  is(ahead.col(0), 0, -1, 0);
  const Eigen::Matrix3d down = from_yaw_pitch_roll({90, -90, 0});
  is(down.col(2), 0, 0, -1);
  is(-down.col(1), 1, 0, 0);                             // the top of the picture is east
  is(from_yaw_pitch_roll({0, 0, 90}).col(0), 0, 0, -1);  // rolled clockwise, right is down
  const Eigen::Matrix3d survey = from_omega_phi_kappa({0, 0, 0});
  is(survey.col(2), 0, 0, -1);
  is(-survey.col(1), 0, 1, 0);  // the top of the picture is north
  for (const Eigen::Vector3d& degrees : {Eigen::Vector3d(10, -60, 5), {-170, 30, -80}, {45, -90, 0}, {20, 90, 0}}) {
    const Eigen::Matrix3d R = from_yaw_pitch_roll(degrees);
    EXPECT_LT((yaw_pitch_roll(R) - degrees).norm(), 1e-6) << degrees.transpose() << " is " << yaw_pitch_roll(R).transpose();
    EXPECT_LT((from_omega_phi_kappa(omega_phi_kappa(R)) - R).norm(), 1e-9);
  }
}

// The code of docs/guide/locate.md (tests/session/readme_test.cpp).
[[maybe_unused]] void code_of_the_guide(const ImageView& image, const Camera& camera, const SE3& T_WC) {
  // README
  auto map = std::make_shared<iclk::GeoMap>("map.tif", "dsm.tif");  // or an iclk::Terrain in memory
  iclk::Locator locator(iclk::open_device(), map);
  iclk::LocatePrior prior{T_WC, 10, 10, 0.05, 0.1};  // approximate pose; m, m, rad, rad
  iclk::Located located = locator.locate(image, camera, prior);
  if (located.converged()) std::cout << located.T_WC.t.transpose() << "\n";  // m, in map->system()
  iclk::SequenceLocator sequence(locator, camera);                           // one frame at a time
  iclk::SequencePose pose = sequence.locate({.time = 0, .image = image, .mask = {}, .prior = prior});
  // end
}

}  // namespace
}  // namespace iclk::test
