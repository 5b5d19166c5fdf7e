#include "apps/iclk/locate/run.h"

#include <cmath>
#include <filesystem>
#include <map>

#include <iclk/align/common/stopwatch.h>
#include <iclk/session/device.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/sequence.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/iclk/locate/priors.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

struct Frame {
  std::string image;
  double time = 0;
  SE3 T_WC;
};

std::vector<Frame> list_frames(const std::vector<std::string>& given) {
  std::vector<Frame> frames;
  if (given.size() == 1 && fs::exists(fs::path(given[0]) / "rgb.txt")) {
    const Sequence recording = load_sequence(given[0], {.need_depth = false});
    for (const SequenceFrame& f : recording.frames) frames.push_back({f.image, f.stamp / recording.unit, {}});
    return frames;
  }
  for (const std::string& path : given) {
    const std::vector<fs::path> files = fs::is_directory(path) ? list_files(path) : std::vector<fs::path>{path};
    for (const fs::path& file : files)
      if (peek_image(file.string()) || !fs::is_directory(path)) frames.push_back({file.string(), 1.0 * frames.size(), {}});
  }
  if (frames.empty()) refuse(given[0] + ": has no image");
  std::map<std::string, std::string> paths;  // priors and overlays go by the names of files
  for (const Frame& frame : frames)
    if (const auto [other, fresh] = paths.emplace(fs::path(frame.image).filename(), frame.image); !fresh)
      refuse(frame.image + " and " + other->second + " have the same name; locate them in two runs");
  return frames;
}

const FramePrior* prior_of(const Frame& frame, const std::vector<FramePrior>& priors) {
  for (const FramePrior& prior : priors) {
    const bool named = !prior.image.empty() && fs::path(prior.image).filename() == fs::path(frame.image).filename();
    if (named || (prior.image.empty() && std::abs(prior.time - frame.time) < 1e-3)) return &prior;
  }
  return nullptr;
}

/// Those frames that have a prior.
std::vector<Frame> frames_with_priors(const LocateRun& run, const MapSystem& map, int& without) {
  const std::vector<FramePrior> priors = load_priors(run.prior, map);
  std::vector<Frame> chosen;
  const std::vector<Frame> all = list_frames(run.frames);
  for (const Frame& frame : all)
    if (const FramePrior* prior = prior_of(frame, priors)) chosen.push_back({frame.image, frame.time, prior->T_WC});
  if (chosen.empty())
    refuse(run.prior + ": no pose is of " + all[0].image + " or another frame; give the names of the files, or their times");
  without = static_cast<int>(all.size() - chosen.size());
  return chosen;
}

/// The map must lie where some prior looks from.
void check_places(const std::vector<Frame>& frames, const GeoMap& map, const LocateRun& run) {
  const MapBox box = map.extent();
  const double reach = run.locator.reach * run.sigmas.position_sigma + 10 * std::max(box.width(), box.height());
  for (const Frame& f : frames)
    if (f.T_WC.t.x() > box.left - reach && f.T_WC.t.x() < box.right + reach && f.T_WC.t.y() > box.bottom - reach &&
        f.T_WC.t.y() < box.top + reach)
      return;
  const Eigen::Vector3d& t = frames[0].T_WC.t;
  refuse(run.prior + ": the first pose is at x " + std::to_string(t.x()) + ", y " + std::to_string(t.y()) +
         ", the map covers " + box.text() + "; are both in the same system of coordinates?");
}

LocatedFrame locate_frame(const LocateRun& run, const Frame& frame, Locator& locator) {
  LocatedFrame result;
  result.image = frame.image, result.time = frame.time;
  cv::Mat image = load_image(frame.image);
  result.camera = fit_camera(run.camera, image.cols, image.rows);
  Levels{image}.apply(image);
  const Distortion& distortion = run.distortion ? *run.distortion : run.camera.distortion;
  cv::Mat seen;  // not the border of the undistorted image
  if (!distortion.empty()) {
    const Undistorter lens(result.camera, distortion);
    image = lens.image(image), seen = lens.seen();
  }
  LocatePrior prior = run.sigmas;
  prior.T_WC = frame.T_WC;
  const internal::Stopwatch time;
  result.located = locator.locate(view(image), result.camera, prior, view(seen));
  result.ms = time.ms();
  if (!result.located.converged()) return result;
  const View map = locator.view(result.camera, result.located.T_WC);
  result.footprint = footprint_of(map, result.camera, result.located.T_WC);
  const fs::path file = fs::path(run.out) / "overlay" / fs::path(frame.image).filename().replace_extension(".png");
  write_file(file.string(), encode_png(located_overlay(map, image, result.camera)));
  return result;
}

}  // namespace

LocateReport run_locate(const LocateRun& run, const Progress& progress) {
  const auto map = std::make_shared<const GeoMap>(run.ortho, run.elevation);
  const MapSystem& system = map->system();
  LocateReport report;
  const std::vector<Frame> frames = frames_with_priors(run, system, report.without_prior);
  check_places(frames, *map, run);
  make_output_folder((fs::path(run.out) / "overlay").string());
  Locator locator(open_device(run.device), map, run.locator);
  const internal::Stopwatch time;
  std::string lines;
  for (const Frame& frame : frames) {
    if (progress) progress("locating", static_cast<int>(report.frames.size()), static_cast<int>(frames.size()));
    report.frames.push_back(locate_frame(run, frame, locator));
    lines += located_json(report.frames.back(), system);
  }
  report.seconds = 1e-3 * time.ms();
  const auto write = [&](const char* name, const std::string& text) { write_file((fs::path(run.out) / name).string(), text); };
  write("located.jsonl", lines);
  write("trajectory.txt", located_tum(report.frames));
  if (system.on_earth()) write("located.geojson", located_geojson(report.frames, system));
  return report;
}

}  // namespace iclk
