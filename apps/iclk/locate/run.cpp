#include "apps/iclk/locate/run.h"

#include <cmath>
#include <filesystem>

#include <iclk/align/common/stopwatch.h>
#include <iclk/session/device.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/iclk/locate/frame_priors.h"
#include "apps/iclk/locate/frames.h"
#include "apps/iclk/locate/pixels.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

LocatedFrame locate_frame(const LocateRun& run, const LocateFrame& frame, Locator& locator) {
  LocatedFrame result;
  result.image = frame.image, result.time = frame.time;
  cv::Mat image = load_image(frame.image);
  result.camera = fit_camera(*run.camera, image.cols, image.rows);
  Levels{image}.apply(image);
  const Distortion& distortion = run.lens();
  cv::Mat seen;  // not the border of the undistorted image
  if (!distortion.empty()) {
    const Undistorter lens(result.camera, distortion);
    image = lens.image(image), seen = lens.seen();
  }
  const internal::Stopwatch time;
  result.located = locator.locate(view(image), result.camera, frame.prior, view(seen));
  result.ms = time.ms();
  if (!result.located.converged()) return result;
  const View map = locator.view(result.camera, result.located.T_WC);
  result.footprint = footprint_of(map, result.camera, result.located.T_WC);
  const fs::path file = fs::path(run.out) / "overlay" / fs::path(frame.image).filename().replace_extension(".png");
  write_file(file.string(), encode_png(located_overlay(map, image, result.camera)));
  return result;
}

/// Writes where the pixels lie that `run.pixels` asks for.
void write_ground(const LocateRun& run, const std::vector<PixelQuery>& pixels, const MapSystem& system, double spacing,
                  Locator& locator, LocateReport& report) {
  GroundOptions options;
  options.distortion = run.lens();
  options.elevation_sigma = run.elevation_sigma.value_or(spacing / 4);
  options.view = [&](const Camera& camera, const SE3& T_WC) { return locator.view(camera, T_WC); };
  report.pixels = static_cast<int>(pixels.size());
  const std::string lines = ground_csv(pixels, report.frames, system, options, report.pixels_on_ground);
  write_file((fs::path(run.out) / "ground.csv").string(), lines);
}

}  // namespace

LocateReport run_locate(const LocateRun& given, const Progress& progress) {
  LocateRun run = given;
  const std::vector<PixelQuery> pixels = run.pixels.empty() ? std::vector<PixelQuery>() : load_pixels(run.pixels);
  const auto map = std::make_shared<const GeoMap>(run.ortho, run.elevation);
  const MapSystem& system = map->system();
  LocateReport report;
  std::optional<CameraFile> camera = run.camera;
  std::vector<LocateFrame> frames = with_priors(list_frames(run.frames), run, system, camera, report.left_out);
  run.camera = camera;
  check_places(frames, *map, run);
  count_heights_as_map(frames, *map, run, report.left_out);
  make_output_folder((fs::path(run.out) / "overlay").string());
  Locator locator(open_device(run.device), map, run.locator);
  const internal::Stopwatch time;
  std::string lines;
  for (const LocateFrame& frame : frames) {
    if (progress) progress("locating", static_cast<int>(report.frames.size()), static_cast<int>(frames.size()));
    report.frames.push_back(locate_frame(run, frame, locator));
    lines += located_json(report.frames.back(), system);
  }
  report.seconds = 1e-3 * time.ms();
  const auto write = [&](const char* name, const std::string& text) { write_file((fs::path(run.out) / name).string(), text); };
  write("located.jsonl", lines);
  write("located.csv", located_csv(report.frames, system));
  write("trajectory.txt", located_tum(report.frames));
  if (system.on_earth()) write("located.geojson", located_geojson(report.frames, system));
  if (!pixels.empty()) write_ground(run, pixels, system, map->spacing(), locator, report);
  return report;
}

}  // namespace iclk
