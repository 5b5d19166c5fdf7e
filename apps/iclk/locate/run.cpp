#include "apps/iclk/locate/run.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <iclk/align/common/stopwatch.h>
#include <iclk/session/device.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/batch/run.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/common/version.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/locate/chain.h"
#include "apps/iclk/locate/frame_priors.h"
#include "apps/iclk/locate/frames.h"
#include "apps/iclk/locate/journal.h"
#include "apps/iclk/locate/picture.h"
#include "apps/iclk/locate/pixels.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

constexpr double kHeightSigma = 0.1;  // of the height above the ground, if the place is unknown

/// Every `every`-th frame, and of these those of the shard.
std::vector<LocateFrame> selected(const std::vector<LocateFrame>& all, const LocateRun& run) {
  std::vector<LocateFrame> frames;
  const size_t every = static_cast<size_t>(run.every), k = static_cast<size_t>(run.shard.k);
  for (size_t i = every * k; i < all.size(); i += every * static_cast<size_t>(run.shard.n)) frames.push_back(all[i]);
  if (frames.empty())
    refuse("there are " + std::to_string(all.size()) + " frames, none of which is in --every " + std::to_string(run.every) +
           " --shard " + std::to_string(run.shard.k) + "/" + std::to_string(run.shard.n));
  return frames;
}

std::string absolute(const std::string& path) { return fs::absolute(path).lexically_normal().string(); }

/// The results depend on these. The names are those of the command line.
nlohmann::ordered_json options_of(const LocateRun& run) {
  const Camera& c = run.camera->camera;
  const PriorOptions& p = run.priors;
  const auto optional = [](const std::optional<double>& value) { return value ? number(*value) : nlohmann::ordered_json(); };
  nlohmann::ordered_json frames = nlohmann::ordered_json::array();
  for (const std::string& path : run.frames) frames.push_back(absolute(path));
  const bool file = fs::is_regular_file(p.source);
  return {{"version", version()},
          {"FRAMES", frames},
          {"--every", run.every},
          {"--sequence", run.sequence},
          {"--ortho", absolute(run.ortho)},
          {"--elevation", absolute(run.elevation)},
          {"--camera", {c.fx, c.fy, c.cx, c.cy, c.width, c.height}},
          {"--distortion", distortion_text(run.lens())},
          {"--anywhere", optional(run.anywhere)},
          {"--prior", file ? absolute(p.source) : p.source},
          {"content of --prior", file ? hash_of(read_file(p.source)) : ""},
          {"--heading", optional(p.heading)},
          {"--pitch", optional(p.pitch)},
          {"--altitude", kAltitudes[static_cast<size_t>(p.altitude)]},
          {"--geoid", optional(p.geoid)},
          {"--prior-sigma", {p.sigmas.position, p.sigmas.angle}},
          {"--height-sigma", optional(p.sigmas.height)},
          {"--heading-sigma", optional(p.sigmas.heading)},
          {"--model", run.locator.session.model}};
}

/// `overlay`: PNG bytes, if the picture is located.
LocatedFrame locate_frame(const LocateRun& run, const LocateFrame& frame, const cv::Mat& image, Locator& locator,
                          std::string& overlay) {
  LocatedFrame result;
  result.image = frame.image, result.time = frame.time;
  const LocatePicture picture(run, image);
  result.camera = picture.camera;
  const internal::Stopwatch time;
  result.located = locator.locate(view(picture.image), picture.camera, frame.prior, view(picture.seen));
  result.ms = time.ms();
  if (result.located.converged()) overlay = draw_located(picture, locator, result);
  return result;
}

/// Locates the frames that have no line yet.
void locate_all(const LocateRun& run, const std::vector<LocateFrame>& frames, LocateFrames& pictures, const MapSystem& system,
                Locator& locator, LocatedJournal& journal, const std::function<void(const ProgressState&)>& progress,
                LocateReport& report) {
  ProgressState state{.unit = "frames", .bad = "not located"};
  state.total = static_cast<int>(frames.size());
  for (const LocateFrame& frame : frames) state.before += journal.has(frame.image);
  report.before = static_cast<int>(journal.frames().size());
  const internal::Stopwatch time;
  std::optional<Error> last;
  for (const LocateFrame& frame : frames) {
    if (journal.has(frame.image)) continue;
    std::optional<LocatedFrame> result;
    std::string overlay;
    try {
      result = locate_frame(run, frame, pictures.read(frame), locator, overlay);
    } catch (const Error& e) {
      if (ends_the_run(e.code())) throw;
      last = e;
      report.failed.push_back(frame.image + ": " + e.what());
    }
    if (!overlay.empty()) write_file((fs::path(run.out) / "overlay" / frame.overlay).string(), overlay);
    if (result) journal.add(*result, system);
    state.failed += !result || !result->located.converged();
    state.done += 1, state.seconds = 1e-3 * time.ms();
    progress(state);
  }
  report.frames = journal.frames();
  if (report.frames.empty() && last) throw *last;
}

void write_results(const LocateRun& run, const MapSystem& system, std::vector<LocatedFrame> frames) {
  std::stable_sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
  const auto write = [&](const char* name, const std::string& text) { write_file((fs::path(run.out) / name).string(), text); };
  write("located.csv", located_csv(frames, system));
  write("trajectory.txt", located_tum(frames));
  if (system.on_earth()) write("located.geojson", located_geojson(frames, system));
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

/// A prior that is the whole map, with any heading.
PriorOptions anywhere_on(const GeoMap& map, const LocateRun& run) {
  PriorOptions priors = run.priors;
  const MapBox box = map.extent();
  const Eigen::Vector2d centre(0.5 * (box.left + box.right), 0.5 * (box.bottom + box.top));
  const Eigen::Vector2d at = map.system().lat_lon(centre.x(), centre.y()).value_or(centre);
  priors.source = fmt::format("{:.9f},{:.9f},{}", at.x(), at.y(), *run.anywhere);
  priors.altitude = Altitude::ground;
  priors.sigmas.position = 0.5 * std::hypot(box.width(), box.height()) / run.locator.reach;
  priors.sigmas.height = priors.sigmas.height.value_or(kHeightSigma * *run.anywhere);
  return priors;
}

}  // namespace

LocateReport run_locate(const LocateRun& given, const std::function<void(const ProgressState&)>& progress) {
  LocateRun run = given;
  const std::vector<PixelQuery> pixels = run.pixels.empty() ? std::vector<PixelQuery>() : load_pixels(run.pixels);
  const auto map = std::make_shared<const GeoMap>(run.ortho, run.elevation);
  const MapSystem& system = map->system();
  if (run.anywhere) run.priors = anywhere_on(*map, run);
  LocateReport report;
  LocateFrames pictures(run.frames);
  if (!pictures.problem().empty()) spdlog::warn("{}", pictures.problem());
  if (pictures.is_video() && run.shard.n == 1) run.sequence = true;
  std::optional<CameraFile> camera = run.camera;
  std::vector<LocateFrame> frames = with_priors(selected(pictures.all(), run), run, system, camera, report.left_out);
  run.camera = camera;
  check_places(frames, *map, run);
  count_heights_as_map(frames, *map, run, report.left_out);
  make_output_folder((fs::path(run.out) / "overlay").string());
  Locator locator(open_device(run.device), map, run.locator);
  LocatedJournal journal(run.out, options_of(run), run.fresh);
  if (run.sequence)
    locate_sequence(run, frames, pictures, system, locator, journal, progress, report);
  else
    locate_all(run, frames, pictures, system, locator, journal, progress, report);
  write_results(run, system, report.frames);
  if (!pixels.empty()) write_ground(run, pixels, system, map->spacing(), locator, report);
  return report;
}

}  // namespace iclk
