#include "apps/iclk/sets/render_options.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <sstream>
#include <tuple>

#include <iclk/engine/error.h>
#include <iclk/render/geotiff.h>
#include <iclk/render/procedural.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/sets/pair_set.h"
#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kWidth = 752, kHeight = 480;
constexpr double kFocal = 455;  // px at kWidth

/// Exactly `count` numbers.
std::vector<double> numbers(const std::string& text, size_t count, const std::string& option) {
  std::vector<double> values = parse_numbers(text, option);
  if (values.size() != count)
    refuse(option + " '" + printable(text) + "': must be " + std::to_string(count) + " numbers, separated by commas");
  return values;
}

/// --size, else the size that the file states, else the default.
LensCamera fitted(const CameraFile& file, const std::string& size) {
  int width = file.camera.width > 0 ? file.camera.width : kWidth, height = file.camera.width > 0 ? file.camera.height : kHeight;
  if (!size.empty()) std::tie(width, height) = parse_size(size, "--size");
  return {fit_camera(file, width, height), Lens(file.distortion)};
}

/// A motion of that size, m and rad, in a direction that the seed draws.
SE3 knock(double metres, double angle, uint64_t seed) {
  std::mt19937_64 random(seed);
  const auto uniform = [&] { return 2 * (static_cast<double>(random() >> 11) * 0x1p-53) - 1; };
  const auto direction = [&] {
    Eigen::Vector3d d;
    do d = {uniform(), uniform(), uniform()};
    while (!(d.norm() < 1 && d.norm() > 0.1));
    return Eigen::Vector3d(d.normalized());
  };
  Vector6d xi;
  xi << metres * direction(), angle * direction();
  return SE3::exp(xi);
}

std::string hash_text(const Terrain& terrain) { return formatted("%016llx", static_cast<unsigned long long>(terrain.hash())); }

double tilt_degrees(const RenderCommand& command) { return command.tilt.value_or(command.orbit.empty() ? 15 : 50); }

constexpr std::array kSeasons{"spring", "summer", "autumn", "winter", "snow"};

}  // namespace

Date parse_date(const std::string& text) {
  const std::vector<std::string> words = split_words(text, ":");
  const auto season = std::find(kSeasons.begin(), kSeasons.end(), words.empty() ? "" : words[0]);
  const auto whole = [](const std::string& word) {
    return !word.empty() && word.size() <= 18 && word.find_first_not_of("0123456789") == std::string::npos;
  };
  const std::vector<double> sun = words.size() == 3 ? parse_numbers(words[2], "the sun") : std::vector<double>(2);
  if (words.size() > 3 || season == kSeasons.end() || (words.size() > 1 && !whole(words[1])) || sun.size() != 2)
    refuse("'" + printable(text) +
           "': must be SEASON[:YEAR[:AZIMUTH,ELEVATION]]: spring, summer, autumn, winter or snow; a whole number; and "
           "where the sun stands, in degrees from north and above the horizon");
  Date date = Date::of(static_cast<Season>(season - kSeasons.begin()), words.size() > 1 ? std::stoull(words[1]) : 0);
  if (words.size() == 3) date.sun_azimuth = sun[0] * kDegree, date.sun_elevation = sun[1] * kDegree;
  date.check();
  return date;
}

std::string to_text(const Date& date) {
  std::ostringstream text;
  text << kSeasons[static_cast<size_t>(date.season)] << ':' << date.year << ':' << date.sun_azimuth / kDegree << ','
       << date.sun_elevation / kDegree;
  return text.str();
}

Terrain make_terrain(const RenderCommand& command) {
  if (command.terrain.empty()) {
    if (command.ortho.empty() || command.elevation.empty())
      refuse("no terrain: give --ortho and --elevation (GeoTIFF), or --terrain procedural:SEED");
    return GeoMap(command.ortho, command.elevation).whole();
  }
  if (!command.ortho.empty() || !command.elevation.empty())
    refuse("--terrain makes its own mosaic and elevation; leave out --ortho and --elevation");
  const auto bad = [&] {
    refuse("--terrain '" + printable(command.terrain) +
           "': must be procedural:SEED or procedural:SEED:METRES, with whole numbers");
  };
  const std::vector<std::string> words = split_words(command.terrain, ":");
  if (words.size() < 2 || words.size() > 3 || words[0] != "procedural") bad();
  for (size_t i = 1; i < words.size(); ++i)
    if (words[i].size() > 18 || words[i].find_first_not_of("0123456789") != std::string::npos) bad();
  ProceduralOptions options{.seed = std::stoull(words[1])};
  if (!command.date.empty()) options.date = parse_date(command.date);
  if (words.size() == 3) options.size = std::stod(words[2]);
  return procedural_terrain(options);
}

RenderedCameras make_cameras(const RenderCommand& command) {
  RenderedCameras cameras;
  if (!command.rig.empty()) {
    const StereoFile file = load_stereo(command.rig);
    SE3 T_rl = file.T_rl;
    if (!command.shock.empty()) {
      const std::vector<double> shock = numbers(command.shock, 2, "--shock");
      if (!(shock[0] >= 0 && shock[0] <= 90 && shock[1] >= 0) || !std::isfinite(shock[1]))
        refuse("--shock " + command.shock + ": must be DEGREES,METRES, 0 to 90 degrees and 0 m or more");
      T_rl = T_rl * knock(shock[1], shock[0] * kDegree, command.pair.seed);
    }
    cameras.left = fitted(file.left, command.size);
    cameras.rig = RenderedRig{file, fitted(file.right, command.size), T_rl};
    return cameras;
  }
  CameraFile file;
  file.source = "--size";
  if (command.camera.empty()) {
    // The default's field of view, across.
    const auto [width, height] = command.size.empty() ? std::pair(kWidth, kHeight) : parse_size(command.size, "--size");
    const double f = kFocal * width / kWidth;
    file.camera = {f, f, 0.5 * (width - 1), 0.5 * (height - 1), width, height};
  } else {
    file = load_camera(command.camera);
  }
  if (!command.distortion.empty()) file.distortion = parse_distortion(command.distortion);
  cameras.left = fitted(file, command.size);
  return cameras;
}

PairOptions pair_options(const RenderCommand& command, const RenderedCameras& cameras) {
  PairOptions options = command.pair;
  options.camera = cameras.left.camera;
  options.lens = cameras.left.lens;
  if (cameras.rig) options.second = {cameras.rig->right.camera, cameras.rig->right.lens, cameras.rig->T_rl};
  const std::vector<double> altitude = numbers(command.altitude, 2, "--altitude"), r = numbers(command.region, 4, "--region");
  options.altitude_min = altitude[0], options.altitude_max = altitude[1];
  options.tilt = tilt_degrees(command) * kDegree;
  options.translation = command.translation;
  options.rotation = command.rotation * kDegree;
  if (!command.orbit.empty()) {
    const std::vector<double> orbit = numbers(command.orbit, 2, "--orbit");
    options.orbit_min = orbit[0] * kDegree, options.orbit_max = orbit[1] * kDegree;
    if (!(options.orbit_max > 0)) refuse("--orbit " + command.orbit + ": MAX must be above 0");
  }
  if (!command.start.empty()) {
    const std::vector<double> start = numbers(command.start, 2, "--start");
    options.start_min = start[0], options.start_max = start[1];
  }
  options.region = {r[0], r[1], r[2], r[3]};
  options.check();
  return options;
}

Json camera_json(const Camera& c) { return {c.fx, c.fy, c.cx, c.cy, c.width, c.height}; }

Json view_options(const RenderCommand& command, const RenderedCameras& cameras, const Terrain& terrain) {
  Json options = {{"terrain", hash_text(terrain)},
                  {"camera", camera_json(cameras.left.camera)},
                  {"samples", command.render.samples},
                  {"anisotropy", command.render.max_anisotropy}};
  // Sets from before these options go on.
  if (!cameras.left.lens.empty()) options["distortion"] = distortion_text(cameras.left.lens.distortion());
  if (cameras.rig) {
    options["right_camera"] = camera_json(cameras.rig->right.camera);
    options["right_distortion"] = distortion_text(cameras.rig->right.lens.distortion());
    options["T_rl"] = pose_json(cameras.rig->T_rl);
  }
  return options;
}

Json set_options(const RenderCommand& command, const PairOptions& p, const RenderedCameras& cameras, const Terrain& terrain,
                 const Terrain* target) {
  Json options = view_options(command, cameras, terrain);
  if (target) options["target_terrain"] = hash_text(*target);
  options.update(Json{{"altitude", {p.altitude_min, p.altitude_max}},
                      {"tilt", tilt_degrees(command)},
                      {"nearest", p.nearest},
                      {"region", {p.region.left, p.region.bottom, p.region.right, p.region.top}},
                      {"seed", p.seed}});
  if (cameras.rig) return options;
  options.update(Json{{"translation", command.translation},
                      {"rotation", command.rotation},
                      {"detector", command.detector},
                      {"count", command.features.count},
                      {"border", command.features.border}});
  if (command.target_depth) options["target_depth"] = true;
  if (!command.orbit.empty()) options["orbit"] = command.orbit;
  if (!command.start.empty()) options["start"] = command.start;
  return options;
}

Json about(const RenderCommand& command, const Terrain& terrain, const std::string& device) {
  Json text = {{"source", command.terrain.empty() ? command.ortho + ", " + command.elevation : command.terrain},
               {"map", terrain.extent().text()},
               {"device", device}};
  if (!command.date.empty()) text["date"] = command.date;
  if (!command.target_date.empty()) text["target_date"] = command.target_date;
  if (!command.target_ortho.empty()) text["target_ortho"] = command.target_ortho;
  if (!command.rig.empty()) text["rig"] = command.rig;
  if (!command.trajectory.empty()) text["trajectory"] = command.trajectory;
  return text;
}

void write_calibrations(const RenderCommand& command, const RenderedRig& rig) {
  const auto write = [&](const std::string& folder, const auto& files) {
    for (const auto& [name, text] : files) {
      const std::string path = command.out + "/" + folder + "/" + name;
      make_output_folder(path.substr(0, path.rfind('/')));
      write_file(path, text);
    }
  };
  write("calibration", rig.file.files);
  write("truth", with_extrinsics(rig.file, rig.T_rl));
}

}  // namespace iclk
