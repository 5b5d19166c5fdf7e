// Where iclk locate gets priors from: columns of sigmas, three numbers, and what pictures state.
#include "apps/iclk/locate/metadata.h"
#include "exif_file.h"
#include "locate_fixture.h"

namespace iclk::test {
namespace {

const std::string kDji = "xmlns:drone-dji=\"http://www.dji.com/drone-dji/1.0/\" ";

std::string gimbal(double yaw, double pitch, double roll) {
  return kDji + fmt::format(
                    "drone-dji:GimbalYawDegree=\"{:+.3f}\" drone-dji:GimbalPitchDegree=\"{:+.3f}\" "
                    "drone-dji:GimbalRollDegree=\"{:+.3f}\" ",
                    yaw, pitch, roll);
}

PictureMetadata written(const ExifFile& file) {
  const Folder folder;
  file.write(folder.path("a.jpg"), cv::Mat(60, 80, CV_8UC3, cv::Scalar(9, 9, 9)));
  return read_metadata(folder.path("a.jpg"));
}

ExifFile good() {
  ExifFile file;
  file.degrees(47.85, 15.01);
  file.altitude = {{561234, 1000}};
  file.xmp = gimbal(92, -60, 3);
  return file;
}

TEST(Metadata, PlaceHeightAndAttitude) {
  const PictureMetadata m = written(good());
  ASSERT_TRUE(m.lat_lon && m.altitude && m.R_WC);
  EXPECT_NEAR(m.lat_lon->x(), 47.85, 1e-7);
  EXPECT_NEAR(m.lat_lon->y(), 15.01, 1e-7);
  EXPECT_NEAR(*m.altitude, 561.234, 1e-3);
  EXPECT_FALSE(m.height || m.ellipsoid || m.camera);
  EXPECT_LT((*m.R_WC - from_yaw_pitch_roll({92, -60, 3})).norm(), 1e-9);
  ExifFile south = good();
  south.north = "S", south.east = "W", south.altitude_reference = 1;
  south.xmp += "drone-dji:AbsoluteAltitude=\"+612.5\" drone-dji:RelativeAltitude=\"+60.10\"";
  const PictureMetadata s = written(south);
  EXPECT_NEAR(s.lat_lon->x(), -47.85, 1e-7);
  EXPECT_NEAR(s.lat_lon->y(), -15.01, 1e-7);
  EXPECT_EQ(*s.altitude, 612.5);
  EXPECT_EQ(*s.height, 60.1);
  south.xmp = "";
  EXPECT_NEAR(*written(south).altitude, -561.234, 1e-3);
  south.altitude_reference = 2;
  EXPECT_TRUE(written(south).ellipsoid);
}

TEST(Metadata, AttitudesOfOtherMakers) {
  ExifFile file = good();
  file.make = "Parrot";
  file.xmp =
      "xmlns:drone-parrot=\"a\" drone-parrot:CameraYawDegree=\"10\" drone-parrot:CameraPitchDegree=\"-80\" "
      "drone-parrot:CameraRollDegree=\"1\"";
  EXPECT_LT((*written(file).R_WC - from_yaw_pitch_roll({10, -80, 1})).norm(), 1e-9);
  file.xmp = "xmlns:cam=\"http://pix4d.com/camera/1.0\" cam:Yaw=\"9000/100\" cam:Pitch=\"20\" cam:Roll=\"0\"";
  EXPECT_FALSE(written(file).R_WC) << "of Parrot, this pitch may count from either";
  EXPECT_NE(written(file).no_attitude.find("cannot tell"), std::string::npos);
  file.make = "Autel Robotics";
  EXPECT_LT((*written(file).R_WC - from_yaw_pitch_roll({90, -70, 0})).norm(), 1e-9) << "its pitch counts from straight down";
  // The right wing is down, so the camera below the body looks to the left: north, if the body heads east.
  file.xmp = "xmlns:Camera=\"b\" Camera:Yaw=\"90\" Camera:Pitch=\"0\" Camera:Roll=\"20\"";
  EXPECT_NEAR(written(file).R_WC->col(2).y(), std::sin(20 * M_PI / 180), 1e-9);
  file.make = "senseFly";
  EXPECT_NEAR(written(file).R_WC->col(2).y(), -std::sin(20 * M_PI / 180), 1e-9);
}

TEST(Metadata, WhatCannotBeTrueIsLeftOut) {
  const auto no_place = [](const auto& change, const std::string& why) {
    ExifFile file = good();
    change(file);
    const PictureMetadata m = written(file);
    EXPECT_FALSE(m.lat_lon) << why;
    EXPECT_NE(m.no_place.find(why), std::string::npos) << m.no_place;
  };
  no_place([](ExifFile& f) { f.degrees(0, 0); }, "0, 0");
  no_place([](ExifFile& f) { f.degrees(95, 15); }, "no latitude");
  no_place([](ExifFile& f) { f.degrees(45, 195); }, "no latitude");
  no_place([](ExifFile& f) { f.latitude = {{47, 1}, {75, 1}, {0, 1}}; }, "no latitude");
  no_place([](ExifFile& f) { f.latitude = {{47, 1}}; }, "no latitude");
  no_place([](ExifFile& f) { f.latitude = f.longitude = {{0, 0}, {0, 0}, {0, 0}}; }, "0, 0");
  no_place([](ExifFile& f) { f.north = f.east = ""; }, "no latitude");
  no_place([](ExifFile& f) { f.latitude.clear(), f.longitude.clear(); }, "no GPS");
  no_place([](ExifFile& f) { f.status = "V"; }, "no fix");
  no_place([](ExifFile& f) { f.xmp += "drone-dji:GpsStatus=\"Invalid\""; }, "no fix");
  for (const char* yaw : {"nan", "inf", "", "12x", "1/0"}) {
    ExifFile file = good();
    file.xmp =
        kDji + "drone-dji:GimbalYawDegree=\"" + yaw + "\" drone-dji:GimbalPitchDegree=\"-90\" drone-dji:GimbalRollDegree=\"0\"";
    EXPECT_FALSE(written(file).R_WC) << yaw;
  }
  ExifFile broken = good();
  broken.xmp = "<<<&";
  EXPECT_FALSE(written(broken).R_WC);
  const Folder folder;
  EXPECT_FALSE(read_metadata(folder.write("text.jpg", "no picture")).lat_lon);
}

TEST(Metadata, ACameraIsACalibration) {
  const auto camera = [](const std::string& data, const std::string& more = "drone-dji:DewarpFlag=\"0\"") {
    ExifFile file = good();
    file.xmp += "drone-dji:DewarpData=\"" + data + "\" " + more;
    return written(file).camera;
  };
  const auto c = camera("2018-09-06;70,71,1.5,-2,-0.26,0.11,0.001,0.002,-0.03");
  ASSERT_TRUE(c);
  EXPECT_EQ(c->camera.fx, 70);
  EXPECT_EQ(c->camera.fy, 71);
  EXPECT_EQ(c->camera.cx, 39.5 + 1.5);
  EXPECT_EQ(c->camera.cy, 29.5 - 2);
  EXPECT_EQ(c->distortion.k, (std::vector<double>{-0.26, 0.11, 0.001, 0.002, -0.03}));
  EXPECT_TRUE(camera("2018-09-06;70,71,1.5,-2,-0.26,0.11,0.001,0.002,-0.03", "drone-dji:DewarpFlag=\"1\"")->distortion.empty());
  EXPECT_FALSE(camera("2018-09-06;70,71,1.5,-2,-0.26,0.11,0.001,0.002,-0.03", ""));
  EXPECT_FALSE(camera("2018-09-06;3670,3671,1.5,-2,-0.26,0.11,0.001,0.002,-0.03")) << "of a larger picture";
  EXPECT_FALSE(camera("2018-09-06;70,71,1.5,-2,nan,0.11,0.001,0.002,-0.03"));
  EXPECT_FALSE(camera("2018-09-06;70,71"));
}

TEST(Metadata, NorthIsThatOfThePlace) {
  const Folder folder;
  GeoTiff map{{4, 4, 700000, 5300000, 1, 1}, {}, GDT_Byte, 32633};
  map.band([](double, double) { return 1; }).write(folder.path("map.tif"));
  const MapSystem system(folder.path("map.tif"));
  PictureMetadata stated;
  stated.lat_lon = Eigen::Vector2d(47.85, 17.5), stated.altitude = 500, stated.R_WC = from_yaw_pitch_roll({90, -60, 2});
  std::string why;
  const auto prior = stated_prior(stated, {}, system, why);
  ASSERT_TRUE(prior) << why;
  // East of the central meridian, 15 degrees, north is to the right of the grid's.
  const double convergence = (17.5 - 15) * std::sin(47.85 * M_PI / 180);
  EXPECT_LT((yaw_pitch_roll(prior->T_WC.R) - Eigen::Vector3d(90 - convergence, -60, 2)).norm(), 0.01)
      << yaw_pitch_roll(prior->T_WC.R).transpose();
}

class LocatePriors : public Locate {
 protected:
  /// The first frame as a drone writes it; z is what `altitude` states.
  static ExifFile drone() {
    ExifFile file;
    const SE3& T = truth_[0];
    const Eigen::Vector2d at = *MapSystem(folder_->path("ortho.tif")).lat_lon(T.t.x() + 3, T.t.y() - 2);
    file.degrees(at.x(), at.y());
    const Eigen::Vector3d angles = yaw_pitch_roll(T.R);
    file.xmp = gimbal(angles.x() + 1, angles.y() + 1, angles.z()) +
               fmt::format("drone-dji:AbsoluteAltitude=\"{:+.2f}\" drone-dji:RelativeAltitude=\"+61.00\" ", T.t.z() + 1);
    return file;
  }
  static void write(const ExifFile& file, const std::string& path) {
    std::filesystem::create_directories(std::filesystem::path(path).parent_path());
    file.write(path, cv::imread(folder_->path("frames/0.png")));
  }
  static void expect_first(const Finished& f, const std::string& out) {
    ASSERT_EQ(f.code, 0) << f.out << f.err;
    const auto poses = load_trajectory(out + "/trajectory.txt");
    ASSERT_FALSE(poses.empty());
    EXPECT_LT((poses[0].T_wc.t - truth_[0].t).norm(), 0.2);
  }
  static inline const std::vector<std::string> kKnown = {"--camera", "300,300,159.5,119.5", "--prior-sigma", "4,3"};
  static std::vector<std::string> known(std::vector<std::string> more) {
    more.insert(more.begin(), kKnown.begin(), kKnown.end());
    return more;
  }
};

TEST_F(LocatePriors, FromWhatPicturesState) {
  const Folder folder;
  write(drone(), folder.path("frames/0.jpg"));
  ExifFile lies = drone();
  lies.degrees(0, 0);
  write(lies, folder.path("frames/1.jpg"));
  const std::string out = folder.path("out");
  const Finished map = locate_on_map(folder.path("frames"), out, kKnown);
  expect_first(map, out);
  EXPECT_NE(map.err.find("height from AbsoluteAltitude"), std::string::npos) << map.err;
  EXPECT_NE(map.err.find("frames without a prior, left out: 1; first"), std::string::npos) << map.err;
  EXPECT_NE(map.err.find("1.jpg: its GPS position is 0, 0"), std::string::npos) << map.err;
  const std::string ground = folder.path("ground");
  const Finished f = locate_on_map(folder.path("frames/0.jpg"), ground, known({"--altitude", "ground"}));
  expect_first(f, ground);
  EXPECT_NE(f.err.find("height from RelativeAltitude"), std::string::npos) << f.err;
}

TEST_F(LocatePriors, TheCameraThatPicturesState) {
  const Folder folder;
  ExifFile file = drone();
  file.xmp += "drone-dji:DewarpFlag=\"0\" drone-dji:DewarpData=\"2018-09-06;300,300,0,0,0,0,0,0,0\" ";
  write(file, folder.path("0.jpg"));
  const std::string out = folder.path("out");
  const Finished f = locate_on_map(folder.path("0.jpg"), out, {"--prior-sigma", "4,3"});
  expect_first(f, out);
  EXPECT_NE(f.err.find("the camera is from DewarpData"), std::string::npos) << f.err;
  write(drone(), folder.path("without/0.jpg"));
  const Finished none = locate_on_map(folder.path("without"), out, {});
  EXPECT_EQ(none.code, 3);
  EXPECT_NE(none.err.find("give --camera"), std::string::npos) << none.err;
}

TEST_F(LocatePriors, FromThreeNumbers) {
  const Folder folder;
  const SE3& T = truth_[0];
  const auto at = [&](double z) { return lat_lon(T.t + Eigen::Vector3d(3, -2, 0)) + fmt::format(",{:.2f}", z); };
  const std::string frame = folder_->path("frames/0.png");
  const auto found = [&](const std::string& prior, std::vector<std::string> more) {
    const Folder out;
    more.insert(more.end(), {"--prior", prior, "--camera", "300,300,159.5,119.5", "--prior-sigma", "4,6"});
    const Finished f = locate_on_map(frame, out.path("out"), more);
    expect_first(f, out.path("out"));
  };
  found(at(T.t.z() + 1), {});
  found(at(T.t.z() + 1), {"--heading", "3", "--pitch", "-86"});
  found(at(61), {"--altitude", "ground", "--heading", "3"});
  found(at(T.t.z() + 45), {"--altitude", "ellipsoid", "--geoid", "44", "--heading", "3"});
}

TEST_F(LocatePriors, OnAMapThatIsNowhere) {
  const Folder folder;
  GeoTiff ortho{terrain_->mosaic, {}, GDT_Byte}, dem{terrain_->relief, {}, GDT_Float32};
  for (int c = 0; c < 3; ++c) {
    ortho.bands.emplace_back();
    for (const uint32_t p : terrain_->rgba) ortho.bands.back().push_back(p >> 8 * c & 255);
  }
  dem.bands.emplace_back(terrain_->height.begin(), terrain_->height.end());
  ortho.write(folder.path("ortho.tif")), dem.write(folder.path("dem.tif"));
  write(drone(), folder.path("0.jpg"));
  const auto located = [&](std::vector<std::string> more) {
    more.insert(more.begin(), {"locate", folder.path("0.jpg"), "--ortho", folder.path("ortho.tif"), "--elevation",
                               folder.path("dem.tif"), "--out", folder.path("out")});
    more.insert(more.end(), kKnown.begin(), kKnown.end());
    return run(more);
  };
  const Eigen::Vector3d t = truth_[0].t + Eigen::Vector3d(2, -2, 1);
  expect_first(located({"--prior", fmt::format("{},{},{}", t.x(), t.y(), t.z()), "--heading", "2"}), folder.path("out"));
  EXPECT_FALSE(std::filesystem::exists(folder.path("out/located.geojson")));
  EXPECT_NE(bytes_of(folder.path("out/located.csv")).find("converged,,,"), std::string::npos);
  EXPECT_NE(located({"--prior", "47.85,15.0,600"}).err.find("same system"), std::string::npos);
  EXPECT_NE(located({}).err.find("names no system"), std::string::npos);
}

TEST_F(LocatePriors, SigmasOfAFrame) {
  const Folder folder;
  const Eigen::Vector3d t = truth_[0].t + Eigen::Vector3d(12, -9, 2), a = yaw_pitch_roll(truth_[0].R);
  const auto located = [&](const std::string& columns, const std::string& sigmas) {
    const std::string csv = folder.write(
        "poses.csv", "image,x,y,z,yaw,pitch,roll" + columns + "\n" +
                         fmt::format("0.png,{},{},{},{},{},{}{}\n", t.x(), t.y(), t.z(), a.x(), a.y(), a.z(), sigmas));
    const Folder out;
    const Finished f = locate_on_map(folder_->path("frames/0.png"), out.path("out"),
                                     {"--camera", "300,300,159.5,119.5", "--prior", csv, "--prior-sigma", "0.1,0"});
    const std::string lines = bytes_of(out.path("out/located.jsonl"));
    const auto first = nlohmann::json::parse(lines.substr(0, lines.find('\n')), nullptr, false);
    return std::pair(f, first.is_object() ? first.value("hypotheses", 0) : 0);
  };
  EXPECT_EQ(located("", "").second, 1);
  const auto [f, hypotheses] = located(",sigma,sigma_z,sigma_heading", ",9,1,5");
  EXPECT_EQ(f.code, 0) << f.out << f.err;
  EXPECT_GT(hypotheses, 1);
  EXPECT_GE(located(",sigma_heading", ",180").second, 12);
  const Finished bad = located(",sigma", ",-1").first;
  EXPECT_EQ(bad.code, 3);
  EXPECT_NE(bad.err.find("poses.csv:2: sigma"), std::string::npos) << bad.err;
}

TEST_F(LocatePriors, WhatIsNotClearIsRefused) {
  const Folder folder;
  const auto refused = [&](std::vector<std::string> more, const std::string& word, const std::string& frames) {
    more.insert(more.end(), {"--camera", "300,300,159.5,119.5"});
    const Finished f = locate_on_map(frames, folder.path("out"), more);
    EXPECT_TRUE(f.code == 3 || f.code == 2) << f.code << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << word << ": " << f.err;
    EXPECT_FALSE(std::filesystem::exists(folder.path("out/located.jsonl")));
  };
  const std::string png = folder_->path("frames/0.png");
  refused({}, "it has no GPS position; give --prior", png);
  refused({"--prior", "500115,5300130,600"}, "no LAT,LON,Z", png);
  refused({"--prior", "47.85,45,600"}, "same system", png);
  refused({"--prior", "-47.85,15,600"}, "same system", png);
  refused({"--prior", "47.85,15.0,600", "--altitude", "ellipsoid"}, "--geoid", png);
  refused({"--prior", "47.85,15.0,600", "--geoid", "44"}, "--altitude ellipsoid", png);
  refused({"--prior", "47.85,15.0,600", "--altitude", "sea"}, "--altitude", png);
  refused({"--prior", "47.85,15.0,600", "--heading", "nan"}, "not finite", png);
  refused({"--prior", priors(folder, "image,x,y,z,yaw,pitch,roll"), "--heading", "10"}, "--heading and --pitch", png);
  refused({"--prior", "47.85,15.01,60", "--altitude", "ground"}, "no height below it", png);
  ExifFile file = drone();
  file.xmp = "";
  write(file, folder.path("bare.jpg"));
  refused({}, "it has no attitude; give --prior", folder.path("bare.jpg"));
  file = drone();
  file.xmp = gimbal(0, -90, 0);
  write(file, folder.path("flat.jpg"));
  refused({}, "it has no altitude", folder.path("flat.jpg"));
  file.altitude = {{600, 1}};
  write(file, folder.path("sea.jpg"));
  refused({"--altitude", "ground"}, "no height above the ground", folder.path("sea.jpg"));
  file.altitude_reference = 2;
  write(file, folder.path("ellipsoid.jpg"));
  refused({}, "--altitude ellipsoid and --geoid", folder.path("ellipsoid.jpg"));
}

}  // namespace
}  // namespace iclk::test
