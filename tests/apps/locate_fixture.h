#pragma once
#include <cmath>

#include <opencv2/imgproc.hpp>

#include <iclk/render/procedural.h>

#include "apps/iclk/locate/priors.h"
#include "command_fixture.h"
#include "device.h"
#include "geotiff_file.h"
#include "render_fixture.h"

namespace iclk::test {

inline constexpr double kEast = 500000, kNorth = 5300000;  // UTM 33, Austria
inline const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};

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

  /// The command on the map.
  static Finished locate_on_map(const std::string& frames, const std::string& out, std::vector<std::string> more) {
    more.insert(more.begin(), {"locate", frames, "--ortho", folder_->path("ortho.tif"), "--elevation", folder_->path("dem.tif"),
                               "--out", out});
    return run(more);
  }
  static Finished locate(const std::string& prior, const std::string& out, std::vector<std::string> more = {}) {
    more.insert(more.begin(), {"--camera", "300,300,159.5,119.5", "--prior", prior, "--prior-sigma", "4,3"});
    return locate_on_map(folder_->path("frames"), out, more);
  }
  /// "LAT,LON", or what a frame's camera is above.
  static std::string lat_lon(const Eigen::Vector3d& at) {
    const Eigen::Vector2d place = *MapSystem(folder_->path("ortho.tif")).lat_lon(at.x(), at.y());
    return fmt::format("{:.9f},{:.9f}", place.x(), place.y());
  }

  static inline Folder* folder_ = nullptr;
  static inline std::shared_ptr<Terrain> terrain_;
  static inline std::vector<SE3> truth_;
};

}  // namespace iclk::test
