#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <future>
#include <optional>

#include <spdlog/spdlog.h>
#include <opencv2/imgproc.hpp>

#include "apps/batch/progress.h"
#include "apps/commands/command.h"
#include "apps/io/camera_file.h"
#include "apps/io/output.h"
#include "apps/io/pose_text.h"
#include "apps/io/text.h"
#include "apps/render/geotiff.h"
#include "apps/render/procedural.h"
#include "apps/session/detect.h"
#include "apps/sets/pair_set.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

struct RenderCommand {
  std::string terrain, ortho, elevation, out, device;
  std::string pose, camera, size = "752x480", altitude = "100,180", region = "0,0,1,1", detector = "random";
  std::string orbit, start;
  int pairs = 0;
  bool target_depth = false;
  double translation = 5.1, rotation = 4.47;
  std::optional<double> tilt;
  RenderOptions render;
  PairOptions pair;
  DetectorOptions features{.count = 50};  // the paper's
};

constexpr double kDegree = M_PI / 180;

const char* const kFooter =
    "The map is in metres: x east, y north, z up. A camera looks along its z, x to the right, y down; T_WC maps its points "
    "into\n"
    "the map. Straight down with north above is '500 500 900 1 0 0 0' at x 500, y 500, 900 m high.\n"
    "\n"
    "--pose writes view.png, depth.tiff (32-bit float metres along the optical axis, 0 = none) and view.json.\n"
    "--pairs writes a set: images/, depth/, features/, set.json and pairs.jsonl, which `iclk batch` takes as it is. Position,\n"
    "altitude, heading, tilt and roll of camera 0 are uniform; camera 1 is camera 0 after a motion of uniform components; a\n"
    "pair of which a view leaves the region or meets missing data is drawn again. With --orbit both cameras are level, "
    "equally\n"
    "far from a point on the ground and look at it, camera 1 from another azimuth, from up to a quarter higher or lower, and\n"
    "turned by --rotation; --altitude is above that point. The same seed gives the same set, bit for bit, on the same device.\n"
    "Run the same command again to continue after a kill; a larger --pairs makes the set longer; other options are refused.\n"
    "\n"
    "Examples:\n"
    "  iclk render --terrain procedural:7 --pairs 2 --out set\n"
    "  iclk batch set/pairs.jsonl --solver device --out set/results.jsonl\n"
    "  iclk render --terrain procedural:7 --pose '512 512 400 1 0 0 0' --out view\n"
    "  iclk render --terrain procedural:7 --pairs 2 --orbit 8,30 --start 50,200 --altitude 60,90 --out orbit\n"
    "  iclk render --ortho rgb.tif --elevation dem.tif --pairs 2 --region 0,0,0.7,1 --out train --size 188x120\n"
    "  iclk render --ortho rgb.tif --elevation dem.tif --pairs 2 --region 0.7,0,1,1 --out test --size 188x120 --seed 1\n"
    "\n";

/// Exactly `count` numbers.
std::vector<double> numbers(const std::string& text, size_t count, const std::string& option) {
  std::vector<double> values = parse_numbers(text, option);
  if (values.size() != count)
    throw Error(ErrorCode::invalid_argument,
                option + " '" + printable(text) + "': " + std::to_string(count) + " numbers are needed, separated by commas");
  return values;
}

Terrain make_terrain(const RenderCommand& command) {
  if (command.terrain.empty()) {
    if (command.ortho.empty() || command.elevation.empty())
      throw Error(ErrorCode::invalid_argument,
                  "which terrain? --ortho and --elevation (GeoTIFF), or --terrain procedural:SEED");
    return load_terrain(command.ortho, command.elevation);
  }
  if (!command.ortho.empty() || !command.elevation.empty())
    throw Error(ErrorCode::invalid_argument, "--terrain makes its own mosaic and elevation; leave out --ortho and --elevation");
  const auto bad = [&] {
    throw Error(ErrorCode::invalid_argument,
                "--terrain '" + printable(command.terrain) +
                    "': procedural:SEED or procedural:SEED:METRES, in whole numbers, is what there is");
  };
  const std::vector<std::string> words = split_words(command.terrain, ":");
  if (words.size() < 2 || words.size() > 3 || words[0] != "procedural") bad();
  for (size_t i = 1; i < words.size(); ++i)
    if (words[i].size() > 18 || words[i].find_first_not_of("0123456789") != std::string::npos) bad();
  ProceduralOptions options{.seed = std::stoull(words[1])};
  if (words.size() == 3) options.size = std::stod(words[2]);
  return procedural_terrain(options);
}

Camera make_camera(const RenderCommand& command) {
  const auto [width, height] = parse_size(command.size, "--size");
  if (command.camera.empty()) {
    // The default's field of view, across.
    const double f = 455.0 * width / 752;
    return {f, f, 0.5 * (width - 1), 0.5 * (height - 1), width, height};
  }
  const CameraFile file = load_camera(command.camera);
  if (!file.distortion.empty())
    throw Error(ErrorCode::unsupported, file.source + " has a distortion; a pinhole camera is rendered: give fx,fy,cx,cy");
  return fit_camera(file, width, height);
}

std::shared_ptr<engine::Context> open_device(std::string wish) {
  const char* variable = std::getenv("ICLK_DEVICE");
  if (wish.empty() && variable != nullptr) wish = variable;
  engine::ContextOptions options;
  options.device = wish;
  auto context = engine::create_context(options);
  if (context->cpu_unasked()) spdlog::warn("no GPU with Vulkan here: running on the CPU device {}", context->info().name);
  return context;
}

void render_view(const RenderCommand& command, TerrainRenderer& renderer, const Camera& camera) {
  const SE3 T_WC = load_pose(command.pose, "--pose");
  const View view = renderer.render(camera, T_WC);
  make_output_folder(command.out);
  write_file(command.out + "/view.png", encode_view(view));
  write_file(command.out + "/depth.tiff", encode_depth(view));
  write_file(
      command.out + "/view.json",
      Json{{"camera", {camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height}}, {"T_WC", tum_line(T_WC)}}
              .dump(2) +
          "\n");
  float nearest = 0, farthest = 0;
  size_t seen = 0;
  for (const float z : view.depth) {
    if (!(z > 0)) continue;
    nearest = seen == 0 ? z : std::min(nearest, z), farthest = std::max(farthest, z);
    ++seen;
  }
  char line[160];
  std::snprintf(line, sizeof line, "%.1f %% of the pixels see ground, %.2f to %.2f m deep; view.png and depth.tiff in ",
                100.0 * static_cast<double>(seen) / static_cast<double>(view.depth.size()), nearest, farthest);
  print(line + command.out + "\n");
  if (seen == 0)
    spdlog::warn("nothing is seen: the map is {}, the camera at {}", renderer.terrain().extent().text(), tum_line(T_WC));
}

double tilt_degrees(const RenderCommand& command) { return command.tilt.value_or(command.orbit.empty() ? 15 : 50); }

PairOptions pair_options(const RenderCommand& command, const Camera& camera) {
  PairOptions options = command.pair;
  options.camera = camera;
  const std::vector<double> altitude = numbers(command.altitude, 2, "--altitude"), r = numbers(command.region, 4, "--region");
  options.altitude_min = altitude[0], options.altitude_max = altitude[1];
  options.tilt = tilt_degrees(command) * kDegree;
  options.translation = command.translation;
  options.rotation = command.rotation * kDegree;
  if (!command.orbit.empty()) {
    const std::vector<double> orbit = numbers(command.orbit, 2, "--orbit");
    options.orbit_min = orbit[0] * kDegree, options.orbit_max = orbit[1] * kDegree;
    if (!(options.orbit_max > 0))
      throw Error(ErrorCode::invalid_argument, "--orbit " + command.orbit + ": MAX must be above 0");
  }
  if (!command.start.empty()) {
    const std::vector<double> start = numbers(command.start, 2, "--start");
    options.start_min = start[0], options.start_max = start[1];
  }
  options.region = {r[0], r[1], r[2], r[3]};
  options.check();
  return options;
}

/// All that the bits of the pairs depend on, but the device.
Json set_options(const RenderCommand& command, const PairOptions& p, const Terrain& terrain) {
  char hash[20];
  std::snprintf(hash, sizeof hash, "%016llx", static_cast<unsigned long long>(terrain.hash()));
  const Camera& c = p.camera;
  Json options = {{"terrain", hash},
                  {"camera", {c.fx, c.fy, c.cx, c.cy, c.width, c.height}},
                  {"altitude", {p.altitude_min, p.altitude_max}},
                  {"tilt", tilt_degrees(command)},
                  {"translation", command.translation},
                  {"rotation", command.rotation},
                  {"nearest", p.nearest},
                  {"region", {p.region.left, p.region.bottom, p.region.right, p.region.top}},
                  {"seed", p.seed},
                  {"detector", command.detector},
                  {"count", command.features.count},
                  {"border", command.features.border},
                  {"samples", command.render.samples},
                  {"anisotropy", command.render.max_anisotropy}};
  // Sets from before these options go on.
  if (command.target_depth) options["target_depth"] = true;
  if (!command.orbit.empty()) options["orbit"] = command.orbit;
  if (!command.start.empty()) options["start"] = command.start;
  return options;
}

Features choose_features(const View& view, DetectorOptions options, uint64_t index) {
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  const cv::Mat depth(view.height, view.width, CV_32FC1, const_cast<float*>(view.depth.data()));
  cv::Mat bgr;
  cv::cvtColor(rgba, bgr, cv::COLOR_RGBA2BGR);
  options.seed = options.seed * 0x9E3779B97F4A7C15u + index;
  return detect_features(bgr, depth, {}, options);
}

std::string megabytes(uint64_t bytes) { return std::to_string((bytes + 999999) / 1000000) + " MB"; }

/// Means of what was drawn, over the whole set.
std::string statistics(const PairSet& set) {
  struct Series {
    const char* name;
    const char* unit;
    double sum = 0, least = INFINITY, greatest = 0;
  } all[] = {{"e_pixel", "px"}, {"e_transl", "m"}, {"e_rot", "rad"}, {"altitude", "m"}};
  for (const auto& [index, line] : set.lines()) {
    const Json& meta = line["meta"];
    for (Series& s : all) {
      const double x = s.name == std::string("altitude") ? meta.value(s.name, NAN) : meta["start"].value(s.name, NAN);
      s.sum += x, s.least = std::min(s.least, x), s.greatest = std::max(s.greatest, x);
    }
  }
  std::string text = "what was drawn, in the mean (least to greatest); errors are those of a start without motion:\n";
  for (const Series& s : all) {
    char row[120];
    std::snprintf(row, sizeof row, "  %-9s %9.4g %-3s (%.4g to %.4g)\n", s.name, s.sum / static_cast<double>(set.size()),
                  s.unit, s.least, s.greatest);
    text += row;
  }
  return text;
}

void render_pairs(const RenderCommand& command, TerrainRenderer& renderer, const Camera& camera, const std::string& device) {
  PairSource source(renderer, pair_options(command, camera));
  DetectorOptions detector = command.features;
  detector.detector = parse_detector(command.detector);
  detector.seed = command.pair.seed;
  detector.check();
  const Terrain& terrain = renderer.terrain();
  PairSet set(command.out, set_options(command, pair_options(command, camera), terrain),
              {{"source", command.terrain.empty() ? command.ortho + ", " + command.elevation : command.terrain},
               {"map", terrain.extent().text()},
               {"device", device}});
  std::vector<uint64_t> todo;
  for (uint64_t i = 0; i < static_cast<uint64_t>(command.pairs); ++i)
    if (!set.has(i)) todo.push_back(i);
  const uint64_t room = largest_pair(camera, detector.count, command.target_depth), needed = room * todo.size(),
                 there = set.free_bytes();
  spdlog::info("{} pairs of {}x{} to render into {}: at most {} ({} a pair), {} are free", todo.size(), camera.width,
               camera.height, command.out, megabytes(needed), megabytes(room), megabytes(there));
  if (needed > there)
    throw Error(ErrorCode::io, command.out + ": " + std::to_string(todo.size()) + " pairs may take " + megabytes(needed) +
                                   ", the disk has " + megabytes(there) + " left; fewer --pairs (a set can be continued)");
  const auto start = Clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
  ProgressBar bar;
  ProgressState state{command.pairs, command.pairs - static_cast<int>(todo.size()), 0, 0, 0};
  // A pair is encoded and written while the next one is rendered.
  std::future<void> writing;
  const auto finish = [&] {
    if (!writing.valid()) return;
    writing.get();
    ++state.done, state.seconds = seconds();
    bar.show(state);
  };
  for (const uint64_t index : todo) {
    auto pair = std::make_shared<const RenderedPair>(source.draw(index));
    finish();
    writing = std::async(std::launch::async, [&, pair, index] {
      set.add(index, *pair, camera, choose_features(pair->view0, detector, index), command.target_depth);
    });
  }
  finish();
  bar.clear();
  if (!todo.empty()) spdlog::info("{}", source.rejected().text());
  print(std::to_string(set.size()) + " pairs of " + std::to_string(camera.width) + "x" + std::to_string(camera.height) +
        " in " + set.manifest() + "; " + std::to_string(todo.size()) + " rendered in " + duration_text(seconds()) + "\n" +
        statistics(set));
}

void run_render(const RenderCommand& command) {
  command.render.check();
  const Camera camera = make_camera(command);
  if (command.pairs > 0) pair_options(command, camera);  // before the terrain is read or made
  const auto context = open_device(command.device);
  TerrainRenderer renderer(context, std::make_shared<const Terrain>(make_terrain(command)), command.render);
  if (command.pairs > 0)
    render_pairs(command, renderer, camera, context->info().name);
  else
    render_view(command, renderer, camera);
}

}  // namespace

void add_render(CLI::App& app, int& exit) {
  CLI::App* sub = app.add_subcommand("render", "Render views, or pairs with truth, of an orthomosaic on its elevation");
  auto o = std::make_shared<RenderCommand>();
  sub->add_option("--ortho", o->ortho, "Orthomosaic: GeoTIFF, 8 bit, grey or RGB, in metres")
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--elevation", o->elevation, "Elevation in metres: GeoTIFF on any grid of the same system")
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--terrain", o->terrain,
                  "procedural:SEED[:METRES], a landscape made in code, 1024 m a side, instead of files")
      ->check(not_empty);
  sub->add_option("--out", o->out, "Folder of the view or the set")->required()->type_name("DIR")->check(not_empty);
  auto* what = sub->add_option_group("what to render");
  what->add_option("--pose", o->pose, "One view from T_WC: TUM line 'tx ty tz qx qy qz qw', 4x4 matrix, or a file with one")
      ->check(not_empty);
  what->add_option("--pairs", o->pairs, "A set of so many pairs")->check(CLI::Range(1, 10000000));
  what->require_option(1);
  sub->add_option("--size", o->size, "Of the images, WIDTHxHEIGHT")->capture_default_str()->check(not_empty);
  sub->add_option("--camera", o->camera,
                  "fx,fy,cx,cy[,width,height] or a camera file as `iclk align` reads it; default: 455 px at 752 px across")
      ->check(not_empty);
  sub->add_option("--altitude", o->altitude, "MIN,MAX m above the ground below camera 0")
      ->capture_default_str()
      ->check(not_empty);
  sub->add_option("--tilt", o->tilt, "Degrees from straight down, at most; default 15, on an orbit 50");
  auto* translation = sub->add_option("--translation", o->translation, "m; each component of camera 1's motion is at most this")
                          ->capture_default_str();
  sub->add_option("--rotation", o->rotation, "Degrees; each component of its rotation vector is at most this")
      ->capture_default_str();
  sub->add_option("--orbit", o->orbit,
                  "MIN,MAX degrees between the azimuths from which both cameras look at one point on the ground")
      ->excludes(translation)
      ->check(not_empty);
  sub->add_option("--start", o->start, "MIN,MAX px; pairs whose views differ by less or more, in the mean, are drawn again")
      ->check(not_empty);
  sub->add_option("--region", o->region,
                  "x0,y0,x1,y1: part of the map that views may see, fractions from the south-west corner")
      ->capture_default_str()
      ->check(not_empty);
  sub->add_option("--seed", o->pair.seed, "Of poses and features")->capture_default_str();
  sub->add_option("--count", o->features.count, "Features of camera 0")->capture_default_str();
  sub->add_option("--border", o->features.border, "Pixels from the image's border to a feature; default 2 P + 1, P = 8")
      ->capture_default_str();
  sub->add_option("--detector", o->detector, "How features are chosen: random (as in the paper), shi-tomasi, grid")
      ->capture_default_str()
      ->check(CLI::IsMember({"shi-tomasi", "grid", "random"}));
  sub->add_flag("--target-depth", o->target_depth, "Write camera 1's depth too, for `iclk eval`'s RgbdOdometry");
  sub->add_option("--samples", o->render.samples, "Rays a pixel and side, 1 to 8: 2 means four rays")->capture_default_str();
  sub->add_option("--anisotropy", o->render.max_anisotropy, "Looks into the mosaic a ray, at most, 1 to 64")
      ->capture_default_str();
  sub->add_option("--device", o->device, "Index, part of a name or UUID; default ICLK_DEVICE, else the best");
  sub->footer(std::string(kFooter) + kExitCodesHelp);
  sub->callback([o, &exit] {
    run_render(*o);
    exit = kConverged;
  });
}

}  // namespace iclk
