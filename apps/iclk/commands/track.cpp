#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/session/depth_sigma.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/commands/program.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/common/progress.h"
#include "apps/iclk/common/settings.h"
#include "apps/iclk/session/run_pairs.h"
#include "apps/iclk/track/run.h"

namespace iclk {
namespace {

constexpr double kStereoSigma = 0.5;  // px of disparity

struct TrackCommand {
  TrackRunOptions run;
  bool peers = false, no_loops = false;
  std::string camera, distortion, solver = "device", readout = "0", depth_sigma;
  Settings settings;
};

const char* const kTrackFooter =
    "FOLDER is one of:\n"
    "  a TUM RGB-D recording (rgb.txt, depth.txt)\n"
    "  a folder with images (rgb, color, images or image) and depth (depth or depths), in files of the same names\n"
    "  a stereo recording in EuRoC's layout (cam0, cam1 with data.csv and sensor.yaml; mav0)\n"
    "  a video file; it needs --camera, and --depth or --features\n"
    "The camera comes from camera.txt (fx fy cx cy width height depth_scale) or --camera. A stereo recording needs neither:\n"
    "its rectified pairs give the depth, and the camera is the rectified left one. With groundtruth.txt the errors are "
    "printed,\n"
    "and --peers adds RgbdOdometry, KLT and SIFT, each from frame to frame. Poses are T_WC, camera to world; the world is the\n"
    "camera of the first keyframe.\n"
    "\n"
    "Written to --out while it runs: live.txt (TUM trajectory, each pose as first estimated) and frames.jsonl (status,\n"
    "covariance, times; docs/schema/frame-1.json). The same command continues a run that was stopped.\n"
    "Written at the end, from the final keyframe poses: trajectory.txt (TUM), trajectory_kitti.txt, keyframes.txt, map.ply\n"
    "and path.png, all of the map with most frames; maps.txt has the poses of all maps, map.state is for --map. evo reads the\n"
    "trajectories:\n"
    "  evo_ape tum groundtruth.txt trajectory.txt -a\n"
    "\n"
    "Examples:\n"
    "  iclk track recording --out tracked\n"
    "  iclk track recording --distortion radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633 --out tracked\n"
    "  iclk track recording --readout auto --out tracked              # rolling shutter, as of a phone or a Kinect\n"
    "  iclk track recording --model sd6dof-small --stride 2\n"
    "  iclk track recording --mask bonnet.png --out tracked\n"
    "  iclk track recording2 --map tracked --out tracked2             # in the map of an earlier run\n"
    "  iclk track recording --depth first.png --out tracked           # depth of the first frame only\n"
    "  iclk track recording --features points --out tracked           # depth of a few points, as a lidar or SLAM has it\n"
    "  iclk track video.mp4 --camera 517.3,516.5,318.6,255.3 --depth depths --depth-scale 5000 --out tracked\n"
    "\n"
    "A frame without depth can become a keyframe too. It takes over features of other keyframes. For new points (--seeds),\n"
    "iclk searches along epipolar lines from frame to frame, until a filter is sure of their depth. The camera must move for\n"
    "this: a camera that only turns gives no depth, and its frames become lost.\n"
    "\n";

/// What a recording's depths are wrong by where nobody says.
std::string depth_sigma_of(const std::string& said, const RecordedFrames& frames, bool own_depth) {
  if (!said.empty() && said != "auto") return said;
  return frames.stereo() && !own_depth ? fmt::format("stereo:{},{}", kStereoSigma, frames.stereo()->baseline())
                                       : "structured-light";
}

TrackRunOptions run_options(const TrackCommand& command) {
  TrackRunOptions options = command.run;
  if (!command.camera.empty()) options.frames.camera = load_camera(command.camera);
  if (!command.distortion.empty()) options.frames.distortion = parse_distortion(command.distortion);
  options.solver = parse_solver(command.solver);
  if (command.no_loops) options.tracker.archive = 0;
  if (const double share = options.frames.depth_holes; !(share >= 0 && share <= 1))
    throw Error(ErrorCode::invalid_argument, fmt::format("--set depth-holes={}: must be 0 to 1", share));
  if (command.readout == "auto") return options;
  const auto ms = to_number(command.readout);
  if (!ms) throw Error(ErrorCode::invalid_argument, "--readout " + command.readout + ": must be a number of ms, or auto");
  options.tracker.readout = *ms / 1000;
  return options;
}

TrackReport track_with_progress(TrackRunOptions& options, RecordedFrames& frames, bool seek_readout) {
  ProgressBar bar;
  internal::Stopwatch watch;
  const auto progress = [&](int done, int total, int lost) {
    if (done == 1) watch = {};
    bar.show({.total = total,
              .before = 0,
              .done = done,
              .failed = lost,
              .seconds = watch.ms() / 1000,
              .unit = "frames",
              .bad = "lost"});
  };
  if (seek_readout) options.tracker.readout = find_readout(options, frames, progress);
  TrackReport report = track_sequence(options, frames, progress);
  report.readout_sought = seek_readout;
  bar.clear();
  return report;
}

void run_track(const TrackCommand& command, TrackPeers peers, int& exit) {
  if (command.peers && !peers) throw NeedsProgram{"peers"};
  TrackRunOptions options = run_options(command);
  RecordedFrames frames(options.frames);
  if (!frames.problem().empty()) spdlog::warn("{}", frames.problem());
  options.tracker.depth_sigma = parse_depth_sigma(
      depth_sigma_of(command.depth_sigma, frames, !options.frames.depth.empty() || !options.frames.features.empty()));
  options.tracker.check();
  const TrackReport report = track_with_progress(options, frames, command.readout == "auto");
  if (report.cpu_unasked) spdlog::warn("no GPU with Vulkan found: running on {}", report.device);
  print(to_text(report));
  if (report.readout_sought && report.readout_used == 0)
    spdlog::warn(
        "--readout auto: the first frames show no readout, nor with 15 ms of either sign: all rows are taken as read at "
        "once; give the readout in ms if you know it");
  if (!report.found()) {
    spdlog::warn("nothing was tracked: check that images and depth belong together, and that their times have the same unit");
    exit = kDiverged;
  }
  if (!options.out.empty())
    print(
        "written    trajectory.txt, trajectory_kitti.txt, live.txt, maps.txt, keyframes.txt, frames.jsonl, map.ply, map.state, "
        "path.png "
        "in " +
        options.out + "\n");
  if (!command.peers) return;
  if (!report.adjusted)
    throw Error(ErrorCode::invalid_argument,
                "--peers needs true poses: there is no groundtruth.txt in " + options.frames.folder);
  print(peers(frames));
}

void add_input(CLI::App& command, TrackCommand& options) {
  command.option_defaults()->group("Input");
  FramesOptions& frames = options.run.frames;
  command.add_option("--camera", options.camera,
                     "fx,fy,cx,cy[,width,height] or a camera file, as for `iclk align`; default: from FOLDER");
  command.add_option("--distortion", options.distortion,
                     "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: from the camera file");
  command
      .add_option(
          "--depth", frames.depth,
          "Depth instead of that in FOLDER: a folder with depth images of the first frames, one per frame, in order; or "
          "the depth image of the first frame alone")
      ->check(CLI::ExistingPath);
  command.add_option("--depth-scale", frames.depth_scale, "Raw units per metre of 16-bit depth; default: from camera.txt");
  command.add_flag("--depth-along-ray", frames.depth_along_ray,
                   "Depths are distances from the camera centre, not depths along the optical axis");
  command.add_option(
      "--depth-sigma", options.depth_sigma,
      "Error of the depth: stereo:PX,BASELINE, structured-light, rendered (exact), or a percentage such as 1.5%. "
      "Default, and auto: structured-light; for a stereo recording a disparity error of half a pixel");
  command
      .add_option(
          "--features", frames.features,
          "Sparse depth instead of that in FOLDER: a folder with a CSV file per frame, as for `iclk align`, with the name "
          "of its image, or in order; frames without a file have no depth")
      ->check(CLI::ExistingDirectory)
      ->excludes("--depth");
  command
      .add_option(
          "--mask", frames.mask,
          "Ignore pixels where this image is 0 (your own vehicle, captions); or a folder with one mask per frame, in order")
      ->check(CLI::ExistingPath);
  command.add_option("--first", frames.first, "First frame, counted from 0")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  command.add_option("--frames", frames.count, "Most frames to track; 0: all")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  command.add_option("--stride", frames.stride, "Use every N-th frame only")->capture_default_str()->check(CLI::PositiveNumber);
  command.add_option("--rate,--fps", frames.rate, "Frames per second, if there are no times in lists, file names or the video")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  command.add_option("--depth-every", frames.depth_every, "Use the depth of every N-th frame only; 0: of the first frame only")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
}

void add_tracking(CLI::App& command, TrackCommand& options) {
  command.option_defaults()->group("Tracking");
  TrackRunOptions& run = options.run;
  TrackerOptions& tracker = run.tracker;
  command
      .add_option(
          "--map", run.map,
          "Folder --out of an earlier run with the same camera: poses are in its map, which grows; the result is in the "
          "--out of this run")
      ->type_name("DIR")
      ->check(CLI::ExistingDirectory);
  command.add_flag("--no-loops", options.no_loops, "Do not recognise places that were seen before");
  command.add_option("--count", tracker.features, "Features per keyframe")->capture_default_str();
  command
      .add_option(
          "--seeds", tracker.seeds,
          "Points per keyframe whose depth is estimated from later frames, where the sensor has too little; 0: none, and "
          "frames without depth do not become keyframes")
      ->capture_default_str();
  command
      .add_option(
          "--readout", options.readout,
          "Rolling shutter: ms from the first row of an image to the last; 0: global shutter; auto: estimated from the first "
          "frames")
      ->capture_default_str();
  command
      .add_option("--model", run.model,
                  "auto (classical; learned models for frames that it cannot place), classical, or a learned model (name or "
                  "file), which takes several times as long per frame")
      ->capture_default_str();
  command.add_option("--solver", options.solver, "device, host or cpu; device: one round trip to the device per frame")
      ->capture_default_str();
  command.add_option("--device", run.device,
                     "Vulkan device: index, UUID or part of the name; default: ICLK_DEVICE, else the best");
}

void add_settings(TrackRunOptions& run, Settings& settings) {
  TrackerOptions& tracker = run.tracker;
  settings.add("keyframes", tracker.keyframes, "2 to 4096", std::to_string(tracker.keyframes),
               "keyframes that frames are aligned with");
  settings.add("archive", tracker.archive, "0 to 100000", std::to_string(tracker.archive),
               "older keyframes that are kept to recognise their places");
  settings.add("window", tracker.window, "1 to 64", std::to_string(tracker.window),
               "newest keyframes that are adjusted together");
  settings.add("min-visible", tracker.min_visible, "0.1 to 1", fmt::format("{}", tracker.min_visible),
               "a frame that sees a smaller share of its keyframe is a new one");
  settings.add("depth-holes", run.frames.depth_holes, "0 to 1", "0", "remove this share of every depth image, in squares");
}

}  // namespace

void add_track(CLI::App& app, int& exit) { add_track(app, exit, nullptr); }

void add_track(CLI::App& app, int& exit, TrackPeers peers) {
  CLI::App* command = app.add_subcommand("track", "Track a camera with depth through a recording: trajectory and sparse map");
  auto options = std::make_shared<TrackCommand>();
  TrackRunOptions& run = options->run;
  command->add_option("FOLDER", run.frames.folder, "Recording: images with depth, or a video; see below")
      ->required()
      ->check(not_empty)
      ->type_name("DIR|VIDEO");
  add_input(*command, *options);
  add_tracking(*command, *options);
  add_settings(run, options->settings);
  options->settings.add_to(*command);
  command->option_defaults()->group("Output");
  command->add_option("--out", run.out, "Folder for the results")->type_name("DIR")->check(not_empty);
  command->add_flag("--fresh", run.fresh, "Start again instead of continuing a run that was stopped");
  command->add_flag("--peers", options->peers, "Also run other methods from frame to frame, and compare with groundtruth.txt");
  command->footer(options->settings.help() + kTrackFooter + exit_codes_help("0 done, 14 nothing was tracked"));
  command->callback([options, peers, &exit] { run_track(*options, peers, exit); });
}

}  // namespace iclk
