#include <memory>
#include <optional>

#include <spdlog/spdlog.h>

#include <iclk/session/device.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/sets/render_options.h"
#include "apps/json/manifest.h"

namespace iclk {
namespace {

const char* const kRenderFooter =
    "The map is in metres: x east, y north, z up. A camera looks along its z axis, with x to the right and y down. T_WC maps\n"
    "points of the camera into the map. '500 500 900 1 0 0 0' looks straight down from x 500, y 500, 900 m high, north up.\n"
    "\n"
    "--pose writes view.png, depth.tiff (32-bit float metres along the optical axis, 0 = none) and view.json.\n"
    "\n"
    "--pairs writes a set: images/, depth/, features/, set.json and pairs.jsonl, a manifest for `iclk batch`. Position,\n"
    "altitude, heading, tilt and roll of camera 0 are uniform. Camera 1 is camera 0 after a motion with uniform components.\n"
    "A pair is drawn again if a view leaves the region or meets missing data. With --orbit both cameras are level and look at\n"
    "one point on the ground, from the same distance. Camera 1 then has another azimuth, is up to a quarter higher or lower,\n"
    "and is turned by --rotation; --altitude is above that point. The same seed on the same device gives the same set, bit\n"
    "for bit.\n"
    "\n"
    "--date and --target-date show procedural terrain on two dates: other leaves, crops, cars and shadows on the same ground.\n"
    "--target-ortho does it with a second orthomosaic.\n"
    "\n"
    "--trajectory writes a flight for `iclk track`: rgb/, depth/, rgb.txt, depth.txt, groundtruth.txt, camera.txt.\n"
    "\n"
    "--rig renders both cameras of a stereo rig. A pose or pairs are written to left/, right/, depth/ and (pairs) rig.jsonl,\n"
    "for `iclk stereo`. The true calibration is in truth/, the given one in calibration/; --shock makes them differ. A flight\n"
    "has EuRoC's layout, with depth/ of the left camera; its trajectory is that of the left camera.\n"
    "\n"
    "To continue after a kill, run the same command again. A larger --pairs makes the set longer; no other option may change.\n"
    "To merge shards, copy their folders into one, append their pairs.jsonl (rig.jsonl) to each other, and run the command\n"
    "there without --shard. The result is that of one run, bit for bit.\n"
    "\n"
    "Examples:\n"
    "  iclk render --terrain procedural:7 --pairs 2 --out set\n"
    "  iclk batch set/pairs.jsonl --solver device --out set/results.jsonl\n"
    "  iclk render --terrain procedural:7 --pose '512 512 400 1 0 0 0' --out view\n"
    "  iclk render --terrain procedural:7 --pairs 2 --orbit 8,30 --start 50,200 --altitude 60,90 --out orbit\n"
    "  iclk render --terrain procedural:7:400 --date summer --target-date snow:1 --pairs 2 --altitude 60,90 --out dates\n"
    "  iclk render --terrain procedural:7:400 --pairs 2 --distortion radtan:-0.28,0.07,0,0 --altitude 60,90 --out lens\n"
    "  iclk render --terrain procedural:7:400 --pairs 2 --altitude 60,90 --out part0 --shard 0/4   # one of four machines\n"
    "  iclk render --terrain procedural:7:400 --trajectory flight.txt --rate 10 --size 188x120 --out flight\n"
    "  iclk track flight --depth-sigma rendered\n"
    "  iclk render --terrain procedural:7:400 --rig rig.yaml --shock 1,0.005 --pairs 3 --altitude 30,40 --out rig\n"
    "  iclk stereo rig --calibration rig/calibration/rig.yaml --out found\n"
    "  iclk render --ortho rgb.tif --elevation dem.tif --pairs 2 --region 0,0,0.7,1 --out train --size 188x120\n"
    "  iclk render --ortho rgb.tif --elevation dem.tif --pairs 2 --region 0.7,0,1,1 --out test --size 188x120 --seed 1\n"
    "\n";

/// The command that makes the terrain of camera 1.
RenderCommand as_target(RenderCommand command) {
  if (!command.target_date.empty()) command.date = command.target_date;
  if (!command.target_ortho.empty()) command.ortho = command.target_ortho;
  return command;
}

void run_render(const RenderCommand& command) {
  command.render.check();
  if (!command.pose.empty() && parse_shard(command.shard).n > 1)
    throw Error(ErrorCode::invalid_argument,
                "--shard " + command.shard + ": a single view (--pose) has no shards; leave --shard out");
  const RenderedCameras cameras = make_cameras(command);
  if (command.pairs > 0) pair_options(command, cameras);  // before the terrain is read or made
  if (!command.trajectory.empty()) check_flight(command);
  const auto context = open_device(command.device);
  const std::string& device = context->info().name;
  if (context->cpu_unasked()) spdlog::warn("no GPU with Vulkan found: running on the CPU device {}", device);
  const auto make = [&](const RenderCommand& what) {
    return TerrainRenderer(context, std::make_shared<const Terrain>(make_terrain(what)), command.render);
  };
  TerrainRenderer renderer = make(command);
  std::optional<TerrainRenderer> target;
  if (!command.target_date.empty() || !command.target_ortho.empty()) target.emplace(make(as_target(command)));
  print(command.pairs > 0             ? render_pairs(command, renderer, target ? &*target : nullptr, cameras, device)
        : !command.trajectory.empty() ? render_flight(command, renderer, cameras, device)
                                      : render_view(command, renderer, cameras));
}

/// A check of an option: what the function that parses it refuses.
template <class Parse>
auto takes(Parse parse) {
  return [parse](const std::string& text) -> std::string {
    try {
      parse(text);
      return "";
    } catch (const Error& e) {
      return e.what();
    }
  };
}

void add_terrain(CLI::App* sub, RenderCommand* o) {
  sub->add_option(
         "--ortho", o->ortho,
         "Orthomosaic: GeoTIFF, 8-bit grey or RGB; poses are in its system, or in its UTM zone if that is not in metres")
      ->type_name("FILE")
      ->check(not_empty);
  sub->add_option("--elevation", o->elevation, "Elevation in metres: GeoTIFF on any grid")->type_name("FILE")->check(not_empty);
  sub->add_option("--terrain", o->terrain,
                  "Instead of files, a procedural landscape: procedural:SEED[:METRES], METRES a side (default 1024)")
      ->check(not_empty);
  sub->add_option("--date", o->date,
                  "When procedural terrain is seen: SEASON[:YEAR[:AZIMUTH,ELEVATION]], a season of spring, summer, autumn, "
                  "winter, snow; the sun casts shadows, in degrees from north and above the horizon")
      ->needs("--terrain")
      ->check(takes(parse_date));
  sub->add_option("--out", o->out, "Folder for the view, set or flight")->required()->type_name("DIR")->check(not_empty);
}

void add_what(CLI::App* sub, RenderCommand* o) {
  auto* what = sub->add_option_group("what to render");
  what->add_option("--pose", o->pose,
                   "One view from the pose T_WC: TUM line 'tx ty tz qx qy qz qw', 4x4 matrix, or a file with one")
      ->check(not_empty);
  what->add_option("--pairs", o->pairs, "A set with this number of pairs")->check(CLI::Range(1, 10000000));
  auto* trajectory = what->add_option("--trajectory", o->trajectory,
                                      "A flight through the poses of a file: TUM lines 'time tx ty tz qx qy qz qw' of T_WC")
                         ->type_name("FILE")
                         ->check(not_empty);
  what->require_option(1);
  sub->add_option("--rate", o->rate,
                  "Frames per second of a flight, interpolated between its poses; default: one frame per pose")
      ->needs(trajectory)
      ->check(CLI::Range(1e-3, 1e5));
  sub->add_option(
         "--readout", o->readout,
         "Rolling shutter of a flight: ms from the first row of an image to the last. Each row has its own pose; the true "
         "pose is that of the middle row")
      ->needs(trajectory)
      ->check(CLI::Range(0.0, 1e3));
  sub->add_option(
         "--shard", o->shard,
         "k/n: only every n-th pair or frame, starting with the k-th (from 0, k < n); shards that run at the same time need "
         "different --out")
      ->capture_default_str()
      ->check(takes(parse_shard));
}

void add_cameras(CLI::App* sub, RenderCommand* o) {
  sub->add_option("--size", o->size, "Image size, WIDTHxHEIGHT; default: from the camera file, else 752x480")->check(not_empty);
  auto* camera = sub->add_option("--camera", o->camera,
                                 "fx,fy,cx,cy[,width,height] or a camera file as for `iclk align`, with its distortion; "
                                 "default: a focal length of 455 px at a width of 752 px")
                     ->check(not_empty);
  auto* distortion = sub->add_option("--distortion", o->distortion,
                                     "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: from the camera file")
                         ->check(not_empty);
  auto* rig =
      sub->add_option("--rig", o->rig,
                      "Render both cameras of a stereo rig: Kalibr camchain, OpenCV stereo YAML, or a folder with EuRoC's "
                      "cam0/sensor.yaml and cam1/sensor.yaml")
          ->check(not_empty)
          ->excludes(camera)
          ->excludes(distortion);
  sub->add_option("--shock", o->shock,
                  "DEGREES,METRES: turn and move the right camera by this much, in directions drawn from --seed")
      ->needs(rig)
      ->excludes(sub->get_option("--trajectory"))
      ->check(not_empty);
}

void add_poses(CLI::App* sub, RenderCommand* o) {
  sub->add_option("--altitude", o->altitude, "MIN,MAX: altitude of camera 0 above the ground below it, m")
      ->capture_default_str()
      ->check(not_empty);
  sub->add_option("--tilt", o->tilt, "Largest angle from straight down, degrees; default: 15, with --orbit 50");
  auto* translation = sub->add_option("--translation", o->translation, "Largest component of the translation of camera 1, m")
                          ->capture_default_str();
  sub->add_option("--rotation", o->rotation, "Largest component of the rotation vector of camera 1, degrees")
      ->capture_default_str();
  sub->add_option("--orbit", o->orbit,
                  "MIN,MAX: both cameras look at one point on the ground, from azimuths that differ by this many degrees")
      ->excludes(translation)
      ->check(not_empty);
  sub->add_option("--start", o->start,
                  "MIN,MAX: mean distance of the features between both views, px; other pairs are drawn again")
      ->check(not_empty);
}

/// What camera 1 of a pair sees in another way.
void add_target(CLI::App* sub, RenderCommand* o) {
  sub->add_option("--target-date", o->target_date, "Camera 1 of a pair sees the terrain at this date; as --date")
      ->needs("--pairs", "--date")
      ->check(takes(parse_date));
  sub->add_option("--target-ortho", o->target_ortho,
                  "Camera 1 of a pair sees this orthomosaic, of the same place at another date; as --ortho")
      ->needs("--pairs", "--ortho")
      ->type_name("FILE")
      ->check(not_empty);
}

void add_features(CLI::App* sub, RenderCommand* o) {
  sub->add_option("--region", o->region,
                  "x0,y0,x1,y1: part of the map that views may see, as fractions from the south-west corner")
      ->capture_default_str()
      ->check(not_empty);
  sub->add_option("--seed", o->pair.seed, "Seed of poses and features")->capture_default_str();
  sub->add_option("--count", o->features.count, "Features of camera 0")->capture_default_str();
  sub->add_option("--border", o->features.border,
                  "Least distance of a feature from the image border, px; default: 2 P + 1 for patches of P = 8")
      ->capture_default_str();
  sub->add_option("--detector", o->detector, "How to choose features: random (as in the paper), shi-tomasi, grid")
      ->capture_default_str()
      ->check(CLI::IsMember({"shi-tomasi", "grid", "random"}));
  sub->add_flag("--target-depth", o->target_depth, "Also write the depth of camera 1, for RgbdOdometry in `iclk eval`");
  sub->add_option("--samples", o->render.samples, "Rays per pixel and direction, 1 to 8: 2 means 2 x 2 rays per pixel")
      ->capture_default_str();
  sub->add_option("--anisotropy", o->render.max_anisotropy, "Most texture samples per ray, 1 to 64")->capture_default_str();
  sub->add_option("--device", o->device, "Vulkan device: index, UUID or part of the name; default: ICLK_DEVICE, else the best");
}

}  // namespace

void add_render(CLI::App& app, int& exit) {
  CLI::App* sub = app.add_subcommand(
      "render", "Render views, pairs with true poses, stereo rigs and flights over an orthomosaic or procedural terrain");
  auto o = std::make_shared<RenderCommand>();
  add_terrain(sub, o.get());
  add_what(sub, o.get());
  add_cameras(sub, o.get());
  add_poses(sub, o.get());
  add_target(sub, o.get());
  add_features(sub, o.get());
  // The second camera of a rig is where the rig has it, and pairs of a rig carry no features.
  for (const char* option : {"--translation", "--rotation", "--orbit", "--start", "--count", "--border", "--detector",
                             "--target-depth", "--target-date", "--target-ortho"})
    sub->get_option("--rig")->excludes(sub->get_option(option));
  sub->footer(kRenderFooter + exit_codes_help("0 done"));
  sub->callback([o, &exit] {
    run_render(*o);
    exit = kConverged;
  });
}

}  // namespace iclk
