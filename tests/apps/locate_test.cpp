// iclk locate as a user runs it, on GeoTIFF files made here.
#include <cmath>

#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/render/procedural.h>

#include "apps/iclk/locate/priors.h"
#include "command_fixture.h"
#include "device.h"
#include "geotiff_file.h"
#include "render_fixture.h"

namespace iclk::test {
namespace {

constexpr double kEast = 500000, kNorth = 5300000;  // UTM 33, Austria
const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};

/// A map in files, and three pictures of it with their poses.
class Locate : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (!device()) return;
    folder_ = new Folder;
    terrain_ = std::make_shared<Terrain>(procedural_terrain({.seed = 3, .size = 256}));
    for (Grid* grid : {&terrain_->relief, &terrain_->mosaic}) grid->left += kEast, grid->top += kNorth;
    write_map();
    TerrainRenderer renderer(device(), terrain_, {.samples = 3});
    std::filesystem::create_directories(folder_->path("frames"));
    for (int i = 0; i < 3; ++i) {
      const double x = kEast + 115 + 10 * i, y = kNorth + 130;
      truth_.push_back(looking_down({x, y, terrain_->height_at(x, y).value() + 60}, 0.3 * i, 0.1));
      const View view = renderer.render(kCamera, truth_.back());
      cv::Mat bgr;
      cv::cvtColor(cv::Mat(240, 320, CV_8UC4, const_cast<uint32_t*>(view.rgba.data())), bgr, cv::COLOR_RGBA2BGR);
      cv::imwrite(folder_->path(fmt::format("frames/{}.png", i)), bgr);
    }
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr, terrain_ = nullptr;
    truth_.clear();
  }
  void SetUp() override { ICLK_NEED_DEVICE(); }

  static void write_map() {
    GeoTiff ortho{terrain_->mosaic, {}, GDT_Byte, 32633}, dem{terrain_->relief, {}, GDT_Float32, 32633};
    for (int c = 0; c < 3; ++c) {
      ortho.bands.emplace_back();
      for (const uint32_t p : terrain_->rgba) ortho.bands.back().push_back(p >> 8 * c & 255);
    }
    dem.bands.emplace_back(terrain_->height.begin(), terrain_->height.end());
    ortho.write(folder_->path("ortho.tif"));
    dem.write(folder_->path("dem.tif"));
  }

  /// Poses that are off by some metres and degrees, in a file.
  static std::string priors(const Folder& folder, const std::string& header) {
    const MapSystem map(folder_->path("ortho.tif"));
    std::string text = header + "\n";
    for (int i = 0; i < 3; ++i) {
      SE3 T = truth_[static_cast<size_t>(i)];
      T.t += Eigen::Vector3d(5, -4, 2);
      const Eigen::Vector2d at = header.find("lat") != std::string::npos ? *map.lat_lon(T.t.x(), T.t.y()) : T.t.head<2>();
      Eigen::Vector3d angles = header.find("yaw") != std::string::npos ? yaw_pitch_roll(T.R) : omega_phi_kappa(T.R);
      angles += Eigen::Vector3d(2, 1, -2);
      text +=
          fmt::format("dir/{}.png,{:.9f},{:.9f},{},{},{},{}\n", i, at.x(), at.y(), T.t.z(), angles.x(), angles.y(), angles.z());
    }
    return folder.write("poses.csv", text);
  }

  static Finished locate(const std::string& prior, const std::string& out, std::vector<std::string> more = {}) {
    more.insert(more.begin(), {"locate", folder_->path("frames"), "--ortho", folder_->path("ortho.tif"), "--elevation",
                               folder_->path("dem.tif"), "--camera", "300,300,159.5,119.5", "--prior", prior, "--prior-sigma",
                               "4,3", "--out", out});
    return run(more);
  }

  static inline Folder* folder_ = nullptr;
  static inline std::shared_ptr<Terrain> terrain_;
  static inline std::vector<SE3> truth_;
};

TEST_F(Locate, FindsPicturesAndWritesWhatItSays) {
  const Folder folder;
  const std::string out = folder.path("out");
  for (const char* header : {"image,lat,lon,z,yaw,pitch,roll", "image,x,y,z,omega,phi,kappa"}) {
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

}  // namespace
}  // namespace iclk::test
