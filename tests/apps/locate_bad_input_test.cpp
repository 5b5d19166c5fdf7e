// What iclk locate does with input that is wrong: it is refused, or the picture is located or not claimed, never put elsewhere.
#include <nlohmann/json.hpp>

#include "exif_file.h"
#include "locate_fixture.h"

namespace iclk::test {
namespace {

class LocateBadInput : public Locate {
 protected:
  Finished at(const std::string& frames, const Eigen::Vector3d& t, const Eigen::Vector3d& angles,
              std::vector<std::string> more = {}) {
    const std::string prior = work_.write("poses.csv", fmt::format("image,x,y,z,yaw,pitch,roll\n0.png,{},{},{},{},{},{}\n",
                                                                   t.x(), t.y(), t.z(), angles.x(), angles.y(), angles.z()));
    more.insert(more.end(), {"--fresh", "--camera", "300,300,159.5,119.5", "--prior", prior, "--prior-sigma", "4,3"});
    return locate_on_map(frames, work_.path("out"), more);
  }
  /// The pose that was claimed, or nothing.
  std::optional<SE3> claimed() const {
    const auto poses = load_trajectory(work_.path("out/trajectory.txt"));
    return poses.empty() ? std::nullopt : std::optional(poses[0].T_wc);
  }
  void expect_true_or_none(const Finished& f, const SE3& truth, const std::string& what) const {
    EXPECT_TRUE(f.code == 0 || f.code == 14) << what << ": " << f.code << f.err;
    const auto pose = f.code == 0 ? claimed() : std::nullopt;
    if (pose) {
      EXPECT_LT((pose->t - truth.t).norm() + 30 * (pose->R - truth.R).norm(), 0.5) << what;
    }
  }
  static std::string first() { return folder_->path("frames/0.png"); }

  Folder work_;
};

TEST_F(LocateBadInput, APriorBesideTheMap) {
  const Eigen::Vector3d down(0, -90, 0), t = truth_[0].t;
  const Finished f = at(first(), t + Eigen::Vector3d(600, 0, 0), down);
  EXPECT_EQ(f.code, 14) << f.out << f.err;
  EXPECT_NE(f.out.find("low_overlap"), std::string::npos) << f.out;
  const Finished below = at(first(), t - Eigen::Vector3d(0, 0, 500), down);
  EXPECT_TRUE(below.code == 14 || below.code == 3) << below.code << below.err;
  EXPECT_EQ(at(first(), t, {0, 60, 0}).code, 14) << "looks into the sky";
  const Finished far = at(first(), t + Eigen::Vector3d(1e6, 0, 0), down);
  EXPECT_EQ(far.code, 3);
  EXPECT_NE(far.err.find("same system"), std::string::npos) << far.err;
}

TEST_F(LocateBadInput, PriorsThatLie) {
  const SE3& T = truth_[0];
  const Eigen::Vector3d a = yaw_pitch_roll(T.R);
  expect_true_or_none(at(first(), T.t + Eigen::Vector3d(45, 0, 0), a), T, "position");
  expect_true_or_none(at(first(), T.t + Eigen::Vector3d(0, 0, 70), a), T, "height");
  expect_true_or_none(at(first(), T.t, a + Eigen::Vector3d(180, 0, 0)), T, "heading");
  expect_true_or_none(at(first(), T.t, a + Eigen::Vector3d(0, 45, 0)), T, "pitch");
}

TEST_F(LocateBadInput, MetadataThatLie) {
  ExifFile file;
  const SE3& T = truth_[0];
  const Eigen::Vector2d place = *MapSystem(folder_->path("ortho.tif")).lat_lon(T.t.x() + 45, T.t.y());
  file.degrees(place.x(), place.y());
  file.altitude = {{static_cast<uint32_t>(T.t.z() + 40), 1}};
  file.xmp = "xmlns:d=\"x\" d:GimbalYawDegree=\"180\" d:GimbalPitchDegree=\"-90\" d:GimbalRollDegree=\"0\"";
  file.write(work_.path("0.jpg"), cv::imread(first()));
  const Finished f = locate_on_map(work_.path("0.jpg"), work_.path("out"), {"--camera", "300,300,159.5,119.5"});
  expect_true_or_none(f, T, "EXIF");
}

TEST_F(LocateBadInput, ACameraUpsideDown) {
  cv::Mat turned;
  cv::rotate(cv::imread(first()), turned, cv::ROTATE_180);
  std::filesystem::create_directories(work_.path("frames"));
  cv::imwrite(work_.path("frames/0.png"), turned);
  SE3 truth = truth_[0];
  truth.R = truth.R * Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Vector3d off(2, -2, 1), a = yaw_pitch_roll(truth_[0].R);
  const Finished f = at(work_.path("frames"), truth.t + off, a + Eigen::Vector3d(1, 1, 180));
  ASSERT_EQ(f.code, 0) << f.out << f.err;
  expect_true_or_none(f, truth, "roll 180");
  expect_true_or_none(at(work_.path("frames"), truth.t + off, a), truth, "roll 0");
  const Finished any = at(work_.path("frames"), truth.t + off, a, {"--heading-sigma", "180"});
  EXPECT_EQ(any.code, 0) << any.out;
  expect_true_or_none(any, truth, "roll 0, any heading");
}

TEST_F(LocateBadInput, NumbersThatAreWrong) {
  const Eigen::Vector3d down(0, -90, 0);
  const auto refused = [&](std::vector<std::string> more, const std::string& word) {
    const Finished f = at(first(), truth_[0].t, down, std::move(more));
    EXPECT_TRUE(f.code == 2 || f.code == 3) << f.code << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << word << ": " << f.err;
    EXPECT_EQ(bytes_of(work_.path("out/located.jsonl")), "");
  };
  refused({"--every", "0"}, "--every");
  refused({"--elevation-sigma", "-1"}, "--elevation-sigma");
  refused({"--elevation-sigma", "nan"}, "--elevation-sigma");
  refused({"--height-sigma", "nan"}, "sigma");
  refused({"--heading-sigma", "-1"}, "sigma");
  refused({"--height-sigma", "1e9"}, "too far");
  refused({"--shard", "1/0"}, "1/0");
  const auto sigma = [&](const std::string& text, const std::string& word) {
    const Finished f = locate_on_map(first(), work_.path("out"),
                                     {"--camera", "300,300,159.5,119.5", "--prior", "47.85,15,600", "--prior-sigma", text});
    EXPECT_EQ(f.code, 3) << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << f.err;
  };
  sigma("4", "METRES,DEGREES");
  sigma("4,x", "'x' is not a number");
  sigma("inf,3", "sigma");
}

TEST_F(LocateBadInput, MapsThatCannotBeUsed) {
  GeoTiff dem{terrain_->relief, {}, GDT_Float32, 32633};
  dem.bands.emplace_back(terrain_->height.begin(), terrain_->height.end());
  const auto refused = [&](const std::string& ortho, const GeoTiff& elevation, const std::string& word) {
    elevation.write(work_.path("dem.tif"));
    const Finished f =
        run({"locate", first(), "--ortho", ortho, "--elevation", work_.path("dem.tif"), "--out", work_.path("out"), "--camera",
             "300,300,159.5,119.5", "--prior", lat_lon(truth_[0].t) + fmt::format(",{}", truth_[0].t.z())});
    EXPECT_EQ(f.code, 3) << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << word << ": " << f.err;
    EXPECT_FALSE(std::filesystem::exists(work_.path("out/located.jsonl")));
  };
  const std::string ortho = folder_->path("ortho.tif");
  GeoTiff feet = dem;
  feet.unit = "ft";
  refused(ortho, feet, "heights in 'ft'; convert them to metres");
  GeoTiff nothing = dem;
  nothing.nodata = "-9999";
  std::fill(nothing.bands[0].begin(), nothing.bands[0].end(), -9999);
  refused(ortho, nothing, "has no data");
  GeoTiff elsewhere = dem;
  elsewhere.grid.left += 5000;
  refused(ortho, elsewhere, "overlap");
  GeoTiff black{terrain_->mosaic, {}, GDT_Byte, 32633};
  black.nodata = "0";
  for (int c = 0; c < 3; ++c) black.bands.emplace_back(terrain_->rgba.size(), 0);
  black.write(work_.path("ortho.tif"));
  refused(work_.path("ortho.tif"), dem, "has no data");
  // A hole below the picture.
  GeoTiff hole = dem;
  hole.nodata = "-9999";
  std::fill(hole.bands[0].begin(), hole.bands[0].end() - 2 * hole.grid.width, -9999);
  hole.write(work_.path("dem.tif"));
  const Finished f =
      run({"locate", first(), "--ortho", ortho, "--elevation", work_.path("dem.tif"), "--out", work_.path("out"), "--camera",
           "300,300,159.5,119.5", "--heading", "0", "--prior", lat_lon(truth_[0].t) + fmt::format(",{}", truth_[0].t.z())});
  EXPECT_EQ(f.code, 14) << f.out << f.err;
  EXPECT_NE(f.out.find("low_overlap"), std::string::npos) << f.out;
}

}  // namespace
}  // namespace iclk::test
