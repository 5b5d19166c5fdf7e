#include <memory>

#include <spdlog/spdlog.h>

#include <iclk/session/device.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/sets/render_options.h"
#include "apps/json/manifest.h"

namespace iclk {
namespace {

const char* const kRenderFooter =
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
    "--trajectory writes a flight as `iclk track` reads it: rgb/, depth/, rgb.txt, depth.txt, groundtruth.txt, camera.txt.\n"
    "\n"
    "With --rig both cameras of a rig look. A pose or pairs are then left/, right/, depth/ and (pairs) rig.jsonl, as `iclk\n"
    "stereo` reads them, with the true calibration in truth/ and the given one in calibration/, which --shock sets apart. A\n"
    "flight is in EuRoC's layout, with depth/ of the left camera, whose way the trajectory is.\n"
    "\n"
    "Run the same command again to continue after a kill; a larger --pairs makes the set longer; other options are refused.\n"
    "Shards in folders of their own are merged by copying them into one, where pairs.jsonl (rig.jsonl) are appended to each\n"
    "other, and running the command there without --shard: the bits are those of one run.\n"
    "\n"
    "Examples:\n"
    "  iclk render --terrain procedural:7 --pairs 2 --out set\n"
    "  iclk batch set/pairs.jsonl --solver device --out set/results.jsonl\n"
    "  iclk render --terrain procedural:7 --pose '512 512 400 1 0 0 0' --out view\n"
    "  iclk render --terrain procedural:7 --pairs 2 --orbit 8,30 --start 50,200 --altitude 60,90 --out orbit\n"
    "  iclk render --terrain procedural:7:400 --pairs 2 --distortion radtan:-0.28,0.07,0,0 --altitude 60,90 --out lens\n"
    "  iclk render --terrain procedural:7:400 --pairs 2 --altitude 60,90 --out part0 --shard 0/4   # one of four machines\n"
    "  iclk render --terrain procedural:7:400 --trajectory flight.txt --rate 10 --size 188x120 --out flight\n"
    "  iclk track flight --depth-sigma rendered\n"
    "  iclk render --terrain procedural:7:400 --rig rig.yaml --shock 1,0.005 --pairs 3 --altitude 30,40 --out rig\n"
    "  iclk stereo rig --calibration rig/calibration/rig.yaml --out found\n"
    "  iclk render --ortho rgb.tif --elevation dem.tif --pairs 2 --region 0,0,0.7,1 --out train --size 188x120\n"
    "  iclk render --ortho rgb.tif --elevation dem.tif --pairs 2 --region 0.7,0,1,1 --out test --size 188x120 --seed 1\n"
    "\n";

void run_render(const RenderCommand& command) {
  command.render.check();
  if (!command.pose.empty() && parse_shard(command.shard).n > 1)
    throw Error(ErrorCode::invalid_argument, "--shard " + command.shard + ": one view has no shards");
  const RenderedCameras cameras = make_cameras(command);
  if (command.pairs > 0) pair_options(command, cameras);  // before the terrain is read or made
  if (!command.trajectory.empty()) check_flight(command);
  const auto context = open_device(command.device);
  const std::string& device = context->info().name;
  if (context->cpu_unasked()) spdlog::warn("no GPU with Vulkan here: running on the CPU device {}", device);
  TerrainRenderer renderer(context, std::make_shared<const Terrain>(make_terrain(command)), command.render);
  print(command.pairs > 0             ? render_pairs(command, renderer, cameras, device)
        : !command.trajectory.empty() ? render_flight(command, renderer, cameras, device)
                                      : render_view(command, renderer, cameras));
}

std::string is_shard(const std::string& text) {
  try {
    parse_shard(text);
    return "";
  } catch (const Error& e) {
    return e.what();
  }
}

void add_terrain(CLI::App* sub, RenderCommand* o) {
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
}

void add_what(CLI::App* sub, RenderCommand* o) {
  auto* what = sub->add_option_group("what to render");
  what->add_option("--pose", o->pose, "One view from T_WC: TUM line 'tx ty tz qx qy qz qw', 4x4 matrix, or a file with one")
      ->check(not_empty);
  what->add_option("--pairs", o->pairs, "A set of so many pairs")->check(CLI::Range(1, 10000000));
  auto* trajectory = what->add_option("--trajectory", o->trajectory,
                                      "A flight through the poses of a file: TUM lines 'time tx ty tz qx qy qz qw' of T_WC")
                         ->type_name("FILE")
                         ->check(not_empty);
  what->require_option(1);
  sub->add_option("--rate", o->rate, "Frames a second of a flight, smoothly between its poses; default: the poses alone")
      ->needs(trajectory)
      ->check(CLI::Range(1e-3, 1e5));
  sub->add_option("--readout", o->readout,
                  "Rolling shutter of a flight: ms from an image's first row to its last, each from its own pose; the truth is "
                  "that of the middle")
      ->needs(trajectory)
      ->check(CLI::Range(0.0, 1e3));
  sub->add_option("--shard", o->shard,
                  "k/n: only every n-th pair or frame, beginning with the k-th, 0 <= k < n; at a time each needs its own --out")
      ->capture_default_str()
      ->check(is_shard);
}

void add_cameras(CLI::App* sub, RenderCommand* o) {
  sub->add_option("--size", o->size, "Of the images, WIDTHxHEIGHT; default: the camera file's, else 752x480")->check(not_empty);
  auto* camera = sub->add_option("--camera", o->camera,
                                 "fx,fy,cx,cy[,width,height] or a camera file as `iclk align` reads it, with its lens; "
                                 "default: 455 px at 752 px across")
                     ->check(not_empty);
  auto* distortion = sub->add_option("--distortion", o->distortion,
                                     "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: the camera file's")
                         ->check(not_empty);
  auto* rig = sub->add_option("--rig", o->rig,
                              "Both cameras of a rig look: Kalibr camchain, OpenCV stereo YAML, or a folder with EuRoC's "
                              "cam0/sensor.yaml and cam1/sensor.yaml")
                  ->check(not_empty)
                  ->excludes(camera)
                  ->excludes(distortion);
  sub->add_option("--shock", o->shock,
                  "DEGREES,METRES: the right camera is turned and moved by so much, in a direction of --seed")
      ->needs(rig)
      ->excludes(sub->get_option("--trajectory"))
      ->check(not_empty);
}

void add_poses(CLI::App* sub, RenderCommand* o) {
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
}

void add_features(CLI::App* sub, RenderCommand* o) {
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
}

}  // namespace

void add_render(CLI::App& app, int& exit) {
  CLI::App* sub =
      app.add_subcommand("render", "Render views, pairs with truth, rigs and flights over an orthomosaic on its elevation");
  auto o = std::make_shared<RenderCommand>();
  add_terrain(sub, o.get());
  add_what(sub, o.get());
  add_cameras(sub, o.get());
  add_poses(sub, o.get());
  add_features(sub, o.get());
  // The second camera of a rig is where the rig has it, and pairs of a rig carry no features.
  for (const char* option :
       {"--translation", "--rotation", "--orbit", "--start", "--count", "--border", "--detector", "--target-depth"})
    sub->get_option("--rig")->excludes(sub->get_option(option));
  sub->footer(kRenderFooter + exit_codes_help("0 done"));
  sub->callback([o, &exit] {
    run_render(*o);
    exit = kConverged;
  });
}

}  // namespace iclk
