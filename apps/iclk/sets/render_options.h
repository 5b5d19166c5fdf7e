#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/render/date.h>
#include <iclk/render/pairs.h>
#include <iclk/session/detect.h>

#include "apps/iclk/io/stereo_file.h"

namespace iclk {

/// What `iclk render` was asked for, as text until it is checked.
struct RenderCommand {
  std::string terrain, date, ortho, elevation, out, device;
  std::string target_date, target_ortho;  ///< of camera 1, if not as camera 0
  std::string pose, trajectory, camera, distortion, rig, shock, size;
  std::string altitude = "100,180", region = "0,0,1,1", detector = "random", orbit, start, shard = "0/1";
  int pairs = 0;
  bool target_depth = false;
  double translation = 5.1, rotation = 4.47, rate = 0, readout = 0;  ///< m, degrees, Hz, ms
  std::optional<double> tilt;
  RenderOptions render;
  PairOptions pair;
  DetectorOptions features{.count = 50};  ///< the paper's
};

/// A camera with its lens.
struct LensCamera {
  Camera camera;
  Lens lens;
};

/// A rig as it is rendered.
struct RenderedRig {
  StereoFile file;  ///< as it was given: a shock is not in it
  LensCamera right;
  SE3 T_rl;  ///< the truth
};

/// The camera, and what else looks.
struct RenderedCameras {
  LensCamera left;  ///< or the only one
  std::optional<RenderedRig> rig;
};

/// SEASON[:YEAR[:AZIMUTH,ELEVATION]], degrees. Throws Error that names the text and what it must be.
Date parse_date(const std::string& text);
std::string to_text(const Date& date);

/// Each throws Error that names the option or the file.
Terrain make_terrain(const RenderCommand& command);
RenderedCameras make_cameras(const RenderCommand& command);
PairOptions pair_options(const RenderCommand& command, const RenderedCameras& cameras);

/// All that the bits of pairs depend on, but the device.
nlohmann::ordered_json set_options(const RenderCommand& command, const PairOptions& options, const RenderedCameras& cameras,
                                   const Terrain& terrain, const Terrain* target);
/// Of one terrain, cameras and renderer: what every kind of rendering depends on.
nlohmann::ordered_json view_options(const RenderCommand& command, const RenderedCameras& cameras, const Terrain& terrain);
/// For people: where all of it came from.
nlohmann::ordered_json about(const RenderCommand& command, const Terrain& terrain, const std::string& device);

nlohmann::ordered_json camera_json(const Camera& camera);

/// Throws what is wrong with --trajectory and its options, before a terrain is read or made.
void check_flight(const RenderCommand& command);

/// Of the terrain that is rendered. These write into command.out, show their progress and return what to print.
std::string render_view(const RenderCommand& command, TerrainRenderer& renderer, const RenderedCameras& cameras);
/// `target`: renders camera 1, if it sees another date; else null.
std::string render_pairs(const RenderCommand& command, TerrainRenderer& renderer, TerrainRenderer* target,
                         const RenderedCameras& cameras, const std::string& device);
std::string render_flight(const RenderCommand& command, TerrainRenderer& renderer, const RenderedCameras& cameras,
                          const std::string& device);

/// The rig's calibration as it was given, in calibration/, and with the true extrinsics, in truth/, of command.out.
void write_calibrations(const RenderCommand& command, const RenderedRig& rig);

}  // namespace iclk
