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
  bool peers = false;
  std::string camera, distortion, solver = "device", readout = "0", depth_sigma;
  Settings settings;
};

const char* const kTrackFooter =
    "FOLDER is a TUM RGB-D recording (rgb.txt, depth.txt), or has a folder rgb, color, images or image and one depth or\n"
    "depths whose files have the same names; with camera.txt (fx fy cx cy width height depth_scale) or --camera. Or it is\n"
    "a stereo recording in EuRoC's layout (cam0, cam1 with data.csv and sensor.yaml; mav0): the rectified pairs give the\n"
    "depth, and the camera is the rectified left one. Or it is a video file, with --camera and --depth. With\n"
    "groundtruth.txt the errors are told, and --peers runs odometry from frame to frame by RgbdOdometry, KLT and SIFT\n"
    "beside it. Poses are T_WC, camera to world; the first keyframe's camera is the world.\n"
    "\n"
    "Written to --out: live.txt (TUM trajectory as each frame was answered) and frames.jsonl (status, covariance, times;\n"
    "docs/schema/frame-1.json) grow with every frame, and a run that was stopped goes on when it is started again;\n"
    "trajectory.txt (TUM), trajectory_kitti.txt, keyframes.txt, map.ply and path.png follow at the end, by the keyframes'\n"
    "last poses. evo reads the trajectories: evo_ape tum groundtruth.txt trajectory.txt -a\n"
    "\n"
    "Examples:\n"
    "  iclk track recording --out tracked\n"
    "  iclk track recording --distortion radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633 --out tracked\n"
    "  iclk track recording --readout auto --out tracked            # a phone's, a Kinect's: rows are read one by one\n"
    "  iclk track recording --model sd6dof-small --stride 2\n"
    "  iclk track recording --mask bonnet.png --out tracked\n"
    "  iclk track recording --depth first.png --out tracked           # depth of the first frame; the rest by motion\n"
    "  iclk track video.mp4 --camera 517.3,516.5,318.6,255.3 --depth depths --depth-scale 5000 --out tracked\n"
    "\n"
    "A frame without depth becomes a keyframe as well: features of others are carried over, and what is new (--seeds) is\n"
    "looked for along its epipolar lines, frame by frame, until a filter is sure of its depth. That needs a camera that\n"
    "moves: of one that only turns, no depth can be found, and the frames are said to be lost.\n"
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
  if (const double share = options.frames.depth_holes; !(share >= 0 && share <= 1))
    throw Error(ErrorCode::invalid_argument, fmt::format("--set depth-holes={}: 0 to 1 expected", share));
  if (command.readout == "auto") return options;
  const auto ms = to_number(command.readout);
  if (!ms) throw Error(ErrorCode::invalid_argument, "--readout " + command.readout + ": a number of ms or auto expected");
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
  options.tracker.depth_sigma = parse_depth_sigma(depth_sigma_of(command.depth_sigma, frames, !options.frames.depth.empty()));
  options.tracker.check();
  const TrackReport report = track_with_progress(options, frames, command.readout == "auto");
  if (report.cpu_unasked) spdlog::warn("no GPU with Vulkan here: running on {}", report.device);
  print(to_text(report));
  if (!report.found()) {
    spdlog::warn("nothing was tracked: do images and depth belong together, and are their times in one unit?");
    exit = kDiverged;
  }
  if (!options.out.empty())
    print("written    trajectory.txt, trajectory_kitti.txt, live.txt, keyframes.txt, frames.jsonl, map.ply, path.png in " +
          options.out + "\n");
  if (!command.peers) return;
  if (!report.live)
    throw Error(ErrorCode::invalid_argument, "--peers needs a truth: groundtruth.txt in " + options.frames.folder);
  print(peers(frames));
}

void add_input(CLI::App& command, TrackCommand& options) {
  command.option_defaults()->group("Input");
  FramesOptions& frames = options.run.frames;
  command.add_option("--camera", options.camera, "fx,fy,cx,cy[,width,height] or a file, as of align; default: FOLDER's");
  command.add_option("--distortion", options.distortion,
                     "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: the camera file's");
  command
      .add_option(
          "--depth", frames.depth,
          "Depth in place of FOLDER's: a folder of depth images, in order one a frame from the first on, as far as they "
          "go; or the first frame's depth image")
      ->check(CLI::ExistingPath);
  command.add_option("--depth-scale", frames.depth_scale, "Raw units a metre of 16-bit depth; default: camera.txt's");
  command.add_flag("--depth-along-ray", frames.depth_along_ray,
                   "Depths are distances from the camera's centre, not depths along its axis");
  command.add_option("--depth-sigma", options.depth_sigma,
                     "Errors of the depth: stereo:PX,BASELINE, structured-light, rendered (exact), or a percentage like 1.5%; "
                     "default, and auto: structured-light; of a "
                     "stereo recording, half a pixel");
  command
      .add_option("--mask", frames.mask,
                  "Hide pixels where this image is 0: your own vehicle, captions; or a folder with a mask a frame, in order")
      ->check(CLI::ExistingPath);
  command.add_option("--first", frames.first, "Frame to begin with")->capture_default_str()->check(CLI::NonNegativeNumber);
  command.add_option("--frames", frames.count, "Frames, at most; 0: all")->capture_default_str()->check(CLI::NonNegativeNumber);
  command.add_option("--stride", frames.stride, "Take every so many frames")->capture_default_str()->check(CLI::PositiveNumber);
  command
      .add_option("--rate,--fps", frames.rate, "Frames a second, where neither lists, names of files nor the video hold times")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  command
      .add_option("--depth-every", frames.depth_every,
                  "Use the depth of one frame of so many, the first of them; 0: of the first alone")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
}

void add_tracking(CLI::App& command, TrackCommand& options) {
  command.option_defaults()->group("Tracking");
  TrackRunOptions& run = options.run;
  TrackerOptions& tracker = run.tracker;
  command.add_option("--count", tracker.features, "Features a keyframe")->capture_default_str();
  command
      .add_option("--seeds", tracker.seeds,
                  "Places a keyframe whose depth the frames that follow tell, where the sensor has too little; 0: none, and "
                  "no keyframes "
                  "of frames without depth")
      ->capture_default_str();
  command
      .add_option("--readout", options.readout,
                  "Rolling shutter: ms from an image's first row to its last; 0: all at once; auto: found by the first frames")
      ->capture_default_str();
  command
      .add_option("--model", run.model,
                  "classical, or a learned model (name or file), which takes several times as long a frame")
      ->capture_default_str();
  command.add_option("--solver", options.solver, "device, host or cpu; device: a frame needs the host once")
      ->capture_default_str();
  command.add_option("--device", run.device,
                     "Vulkan device: index, part of its name or UUID; default: ICLK_DEVICE, else the best");
}

void add_settings(TrackRunOptions& run, Settings& settings) {
  TrackerOptions& tracker = run.tracker;
  settings.add("keyframes", tracker.keyframes, "2 to 4096", std::to_string(tracker.keyframes), "held; the oldest leave");
  settings.add("window", tracker.window, "1 to 64", std::to_string(tracker.window), "newest keyframes, adjusted together");
  settings.add("min-visible", tracker.min_visible, "0.1 to 1", fmt::format("{}", tracker.min_visible),
               "a frame that sees less of its keyframe's features becomes one");
  settings.add("depth-holes", run.frames.depth_holes, "0 to 1", "0", "take this share of every depth image away, in squares");
}

}  // namespace

void add_track(CLI::App& app, int& exit) { add_track(app, exit, nullptr); }

void add_track(CLI::App& app, int& exit, TrackPeers peers) {
  CLI::App* command = app.add_subcommand("track", "Follow a camera with depth through a recording: trajectory and sparse map");
  auto options = std::make_shared<TrackCommand>();
  TrackRunOptions& run = options->run;
  command->add_option("FOLDER", run.frames.folder, "Recording: images with depth, or a video")
      ->required()
      ->check(not_empty)
      ->type_name("DIR|VIDEO");
  add_input(*command, *options);
  add_tracking(*command, *options);
  add_settings(run, options->settings);
  options->settings.add_to(*command);
  command->option_defaults()->group("Output");
  command->add_option("--out", run.out, "Folder for what is written")->type_name("DIR")->check(not_empty);
  command->add_flag("--fresh", run.fresh, "Begin anew where a run was stopped, instead of going on");
  command->add_flag("--peers", options->peers, "Other methods from frame to frame, beside the truth");
  command->footer(options->settings.help() + kTrackFooter + exit_codes_help("0 done, 14 nothing was tracked"));
  command->callback([options, peers, &exit] { run_track(*options, peers, exit); });
}

}  // namespace iclk
