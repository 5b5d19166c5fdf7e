#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <iclk/session/io/distortion.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/median.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/locate/run.h"

namespace iclk {
namespace {

struct LocateCommand {
  LocateRun run;
  std::string camera, distortion, sigma = "10,5", shard = "0/1";
  std::string altitude = "map", model = default_model();
};

const char* const kLocateFooter =
    "The map is an orthophoto and its elevation, of any size and in any coordinate systems. Positions are in the system of "
    "the\n"
    "orthophoto if that is projected and in metres, else in its UTM zone. A pose T_WC maps points of the camera (x right, y\n"
    "down, z forward) into the map (x east, y north, z up).\n"
    "\n"
    "--prior is one of:\n"
    "  CSV, with a header: image, then x,y,z or lat,lon,z, then yaw,pitch,roll or omega,phi,kappa. Metres and degrees.\n"
    "    yaw: clockwise from north; pitch: up from the horizon, -90 looks straight down; roll: clockwise.\n"
    "    sigma, sigma_z (m), sigma_angle, sigma_heading (degrees): in place of --prior-sigma and the others, for this frame.\n"
    "  TUM lines 'time tx ty tz qx qy qz qw' of T_WC; the times are those of rgb.txt.\n"
    "  LAT,LON,Z: one place for all frames; X,Y,Z if the map has no system of coordinates.\n"
    "Without --prior, EXIF has the position, and the XMP of DJI, Autel, Parrot, senseFly, Sentera or MicaSense the attitude.\n"
    "\n"
    "--out gets located.jsonl (docs/schema/located-1.json), located.csv, trajectory.txt (TUM), located.geojson (positions and\n"
    "footprints for QGIS, if the map has a system of coordinates) and overlay/ (map red, picture cyan: grey where they "
    "agree).\n"
    "\n"
    "located.jsonl grows with every frame. The same command continues a run that was stopped; sequences begin anew. Frames of "
    "a\n"
    "video are named video.mp4#000123.\n"
    "\n"
    "--pixels adds ground.csv: image,u,v,lat,lon,x,y,z and standard deviations, m: sigma_major, sigma_minor, sigma_z, with "
    "the\n"
    "azimuth of the major axis, degrees from north.\n"
    "\n"
    "Examples:\n"
    "  iclk locate frames --ortho map.tif --elevation dsm.tif --camera camera.yaml --prior poses.csv --out located\n"
    "  iclk locate a.jpg --ortho map.tif --elevation dsm.tif --camera camera.yaml --prior poses.csv --prior-sigma 3,2 --out a\n"
    "  iclk locate frames --ortho map.tif --elevation dsm.tif --camera camera.yaml --altitude ground --out b  # from EXIF\n"
    "  iclk locate a.jpg --ortho map.tif --elevation dsm.tif --camera camera.yaml --prior 47.85,15.01,620 --out c\n"
    "  iclk locate a.jpg --ortho map.tif --elevation dsm.tif --camera camera.yaml --anywhere 50 --out d\n"
    "\n";

LocateRun prepared(const LocateCommand& command) {
  LocateRun run = command.run;
  if (!command.camera.empty()) run.camera = load_camera(command.camera);
  if (!command.distortion.empty()) run.distortion = parse_distortion(command.distortion);
  const std::vector<double> sigma = parse_numbers(command.sigma, "--prior-sigma");
  if (sigma.size() != 2) refuse("--prior-sigma " + command.sigma + ": must be METRES,DEGREES, such as 10,5");
  PriorOptions& priors = run.priors;
  priors.sigmas.position = sigma[0], priors.sigmas.angle = sigma[1];
  priors.sigmas.around({});  // checks them
  priors.altitude =
      static_cast<Altitude>(std::find(kAltitudes.begin(), kAltitudes.end(), command.altitude) - kAltitudes.begin());
  if ((priors.altitude == Altitude::ellipsoid) != priors.geoid.has_value())
    refuse("--altitude ellipsoid needs --geoid, the height of the geoid above the ellipsoid there, and only it takes --geoid");
  run.shard = parse_shard(command.shard);
  if (run.sequence && run.shard.n > 1) refuse("--sequence needs all frames: leave out --shard " + command.shard);
  if (run.elevation_sigma && !std::isfinite(*run.elevation_sigma)) refuse("--elevation-sigma must be finite");
  run.locator.session.model = command.model;
  run.locator.session.device = run.device;
  return run;
}

std::string report_text(const LocateReport& report, const std::string& out) {
  std::string text;
  std::vector<double> ms;
  size_t located = 0, tracked = 0;
  for (size_t i = 0; i < report.frames.size(); ++i) {
    const LocatedFrame& f = report.frames[i];
    const Located& l = f.located;
    located += l.converged(), tracked += f.tracked;
    ms.push_back(f.ms);
    if (i < static_cast<size_t>(report.before)) continue;
    text += fmt::format("{}  {}", f.image, f.status());
    if (f.has_pose())
      text += fmt::format("  x {:.2f}  y {:.2f}  z {:.2f} m, 1 sigma {:.2f} m", l.T_WC.t.x(), l.T_WC.t.y(), l.T_WC.t.z(),
                          std::sqrt(l.covariance.topLeftCorner<3, 3>().trace()));
    text += "\n";
  }
  text += fmt::format("\nlocated    {} of {} frames, {:.0f} ms per frame\n", located, ms.size(), median(ms));
  if (tracked > 0) text += fmt::format("tracked    {} frames, by the motion between frames\n", tracked);
  if (report.before > 0) text += fmt::format("continued  {} frames are of earlier runs\n", report.before);
  if (report.pixels > 0) text += fmt::format("ground     {} of {} pixels\n", report.pixels_on_ground, report.pixels);
  return text + "written    located.jsonl, located.csv, trajectory.txt" + (report.pixels > 0 ? ", ground.csv" : "") +
         " and overlay/ in " + out + "\n";
}

void run_locate_command(const LocateCommand& command, int& exit) {
  ProgressBar bar;
  const LocateReport report = run_locate(prepared(command), [&](const ProgressState& state) { bar.show(state); });
  bar.clear();
  const auto warn = [](const char* what, const std::vector<std::string>& frames) {
    if (!frames.empty()) spdlog::warn("{}: {}; first {}", what, frames.size(), frames.front());
  };
  warn("frames that failed", report.failed);
  warn("frames without a prior, left out", report.left_out);
  print(report_text(report, command.run.out));
  const bool any =
      std::any_of(report.frames.begin(), report.frames.end(), [](const LocatedFrame& f) { return f.located.converged(); });
  exit = any ? kConverged : kDiverged;
}

}  // namespace

void add_locate(CLI::App& app, int& exit) {
  CLI::App* sub = app.add_subcommand("locate", "Find where pictures were taken, on an orthophoto with elevation");
  auto o = std::make_shared<LocateCommand>();
  LocateRun& run = o->run;
  sub->add_option("FRAMES", run.frames, "Images, a folder of images, a recording with rgb.txt, or a video")
      ->required()
      ->check(not_empty)
      ->type_name("PATH ...");
  sub->add_option("--every", run.every, "Locate every N-th frame only")->capture_default_str()->check(CLI::PositiveNumber);
  sub->add_flag("--sequence", run.sequence,
                "Frames follow each other: a frame that the map does not show gets its pose from the motion between frames. "
                "Implied for a video");
  sub->add_option("--shard", o->shard,
                  "k/n: only every n-th frame, starting with the k-th (from 0, k < n); each shard needs its own --out")
      ->capture_default_str();
  sub->option_defaults()->group("Map and camera");
  sub->add_option("--ortho", run.ortho, "Orthophoto: GeoTIFF, COG or VRT, 8 bit, grey or RGB")
      ->required()
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--elevation", run.elevation, "Elevation in metres, on any grid; best a DSM")
      ->required()
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--camera", o->camera,
                  "fx,fy,cx,cy[,width,height] in pixels, or a camera file as `iclk align` reads it; default: DJI's calibration "
                  "in the pictures (DewarpData)")
      ->check(not_empty);
  sub->add_option("--distortion", o->distortion,
                  "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: the file's")
      ->check(not_empty);
  sub->option_defaults()->group("Prior");
  PriorOptions& priors = run.priors;
  sub->add_option("--prior", priors.source,
                  "Approximate poses of the frames: CSV or TUM lines, see below; or LAT,LON,Z, one place for all frames, in a "
                  "sequence for the first. Default: what the pictures state")
      ->type_name("FILE|LAT,LON,Z")
      ->check(not_empty);
  sub->add_option("--anywhere", run.anywhere,
                  "Instead of --prior: search the whole map, for a camera that looks down from this height above the ground")
      ->type_name("METRES")
      ->check(CLI::Range(1.0, 1e5))
      ->excludes("--prior");
  sub->add_option("--heading", priors.heading, "For LAT,LON,Z: clockwise from north; default: unknown")->type_name("DEGREES");
  sub->add_option("--pitch", priors.pitch, "For LAT,LON,Z: up from the horizon. Default -90, straight down")
      ->type_name("DEGREES");
  sub->add_option("--altitude", o->altitude,
                  "What heights of priors count from: map, as the elevation; ground, below the camera; ellipsoid")
      ->check(CLI::IsMember(std::vector<std::string>(kAltitudes.begin(), kAltitudes.end())))
      ->capture_default_str();
  sub->add_option("--geoid", priors.geoid, "For --altitude ellipsoid: height of the geoid above the ellipsoid there")
      ->type_name("METRES");
  sub->add_option("--prior-sigma", o->sigma, "Standard deviations of position and attitude")
      ->type_name("METRES,DEGREES")
      ->capture_default_str();
  sub->add_option("--height-sigma", priors.sigmas.height, "Of the height, m; default: that of the position")
      ->type_name("METRES");
  sub->add_option("--heading-sigma", priors.sigmas.heading,
                  "Of the heading, degrees; 180: unknown. Default: that of the attitude")
      ->type_name("DEGREES");
  sub->option_defaults()->group("Alignment");
  sub->add_option("--model", o->model, "auto, classical, or a learned model, as in `iclk align`")->capture_default_str();
  sub->add_option("--device", run.device,
                  "Vulkan device: index, part of its name or UUID; default: ICLK_DEVICE, else the best");
  sub->option_defaults()->group("Output");
  sub->add_option("--out", run.out, "Folder for the results")->required()->type_name("DIR")->check(not_empty);
  sub->add_flag("--fresh", run.fresh, "Begin anew instead of continuing what is in --out");
  sub->add_option("--pixels", run.pixels,
                  "CSV with image, u and v, in pixels of the pictures as they are: ground.csv gets their places on the ground")
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--elevation-sigma", run.elevation_sigma,
                  "Standard deviation of the map's heights, for --pixels; default: a quarter of their spacing")
      ->type_name("METRES")
      ->check(CLI::NonNegativeNumber);
  sub->footer(kLocateFooter + exit_codes_help("0 at least one frame was located, 14 none"));
  sub->callback([o, &exit] { run_locate_command(*o, exit); });
}

}  // namespace iclk
