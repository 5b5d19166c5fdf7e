#include <algorithm>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <iclk/session/io/distortion.h>

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
  std::string camera, distortion;
  std::vector<double> sigma = {10, 5};
  std::optional<double> height_sigma, heading_sigma;
  std::string model = default_model();
};

const char* const kLocateFooter =
    "The map is an orthophoto and its elevation, in one projected system in metres. A pose T_WC maps points of the camera (x\n"
    "right, y down, z forward) into the map (x east, y north, z up). Heights are those of the elevation model.\n"
    "\n"
    "--prior has one pose per frame:\n"
    "  CSV, with a header: image, then x,y,z or lat,lon,z, then yaw,pitch,roll or omega,phi,kappa. Metres and degrees.\n"
    "    yaw: clockwise from north; pitch: up from the horizon, -90 looks straight down; roll: clockwise.\n"
    "  TUM lines 'time tx ty tz qx qy qz qw' of T_WC; the times are those of rgb.txt.\n"
    "\n"
    "--out gets located.jsonl (docs/schema/located-1.json), trajectory.txt (TUM), located.geojson (positions and footprints "
    "for\n"
    "QGIS, if the map has a system of coordinates) and overlay/ (map red, picture cyan: grey where they agree).\n"
    "\n"
    "Examples:\n"
    "  iclk locate frames --ortho map.tif --elevation dsm.tif --camera camera.yaml --prior poses.csv --out located\n"
    "  iclk locate a.jpg --ortho map.tif --elevation dsm.tif --camera camera.yaml --prior poses.csv --prior-sigma 3,2 --out a\n"
    "  iclk locate frames --ortho map.tif --elevation dsm.tif --camera camera.yaml --prior poses.csv --heading-sigma 180 --out "
    "b\n"
    "\n";

LocateRun prepared(const LocateCommand& command) {
  LocateRun run = command.run;
  run.camera = load_camera(command.camera);
  if (!command.distortion.empty()) run.distortion = parse_distortion(command.distortion);
  if (command.sigma.size() != 2) refuse("--prior-sigma wants METRES,DEGREES, like 10,5");
  run.sigmas.position_sigma = command.sigma[0];
  run.sigmas.height_sigma = command.height_sigma.value_or(command.sigma[0]);
  run.sigmas.tilt_sigma = command.sigma[1] * kDegree;
  run.sigmas.heading_sigma = command.heading_sigma.value_or(command.sigma[1]) * kDegree;
  run.sigmas.check();
  run.locator.session.model = command.model;
  run.locator.session.device = run.device;
  return run;
}

std::string report_text(const LocateReport& report, const std::string& out) {
  std::string text;
  std::vector<double> ms;
  size_t located = 0;
  for (const LocatedFrame& f : report.frames) {
    const Located& l = f.located;
    located += l.converged();
    ms.push_back(f.ms);
    text += fmt::format("{}  {}", f.image, name(l.status));
    if (l.converged())
      text += fmt::format("  x {:.2f}  y {:.2f}  z {:.2f} m, 1 sigma {:.2f} m", l.T_WC.t.x(), l.T_WC.t.y(), l.T_WC.t.z(),
                          std::sqrt(l.covariance.topLeftCorner<3, 3>().trace()));
    text += "\n";
  }
  text += fmt::format("\nlocated    {} of {} frames, {:.0f} ms per frame\n", located, ms.size(), median(ms));
  return text + "written    located.jsonl, trajectory.txt and overlay/ in " + out + "\n";
}

void run_locate_command(const LocateCommand& command, int& exit) {
  const LocateReport report = run_locate(prepared(command), terminal_progress());
  if (report.without_prior > 0)
    spdlog::warn("{} frames have no pose in {} and were left out", report.without_prior, command.run.prior);
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
  sub->add_option("FRAMES", run.frames, "Images, a folder of images, or a recording with rgb.txt")
      ->required()
      ->check(not_empty)
      ->type_name("PATH ...");
  sub->option_defaults()->group("Map and camera");
  sub->add_option("--ortho", run.ortho, "Orthophoto: GeoTIFF, 8 bit, grey or RGB")
      ->required()
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--elevation", run.elevation, "Elevation in metres: GeoTIFF on any grid of the same system; best a DSM")
      ->required()
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--camera", o->camera, "fx,fy,cx,cy[,width,height] in pixels, or a camera file as `iclk align` reads it")
      ->required()
      ->check(not_empty);
  sub->add_option("--distortion", o->distortion,
                  "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: the file's")
      ->check(not_empty);
  sub->option_defaults()->group("Prior");
  sub->add_option("--prior", run.prior, "Approximate poses of the frames: CSV or TUM lines, see below")
      ->required()
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--prior-sigma", o->sigma, "METRES,DEGREES: standard deviations of position and attitude. Default 10,5")
      ->delimiter(',')
      ->expected(2)
      ->type_name("METRES,DEGREES");
  sub->add_option("--height-sigma", o->height_sigma, "Of the height, m; default: that of the position")->type_name("METRES");
  sub->add_option("--heading-sigma", o->heading_sigma, "Of the heading, degrees; 180: unknown. Default: that of the attitude")
      ->type_name("DEGREES");
  sub->option_defaults()->group("Alignment");
  sub->add_option("--model", o->model, "auto, classical, or a learned model, as in `iclk align`")->capture_default_str();
  sub->add_option("--device", run.device,
                  "Vulkan device: index, part of its name or UUID; default: ICLK_DEVICE, else the best");
  sub->option_defaults()->group("Output");
  sub->add_option("--out", run.out, "Folder for the results")->required()->type_name("DIR")->check(not_empty);
  sub->footer(kLocateFooter + exit_codes_help("0 at least one frame was located, 14 none"));
  sub->callback([o, &exit] { run_locate_command(*o, exit); });
}

}  // namespace iclk
