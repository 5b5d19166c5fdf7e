#include <cmath>
#include <memory>

#include <spdlog/spdlog.h>

#include <iclk/align/common/stopwatch.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/common/progress.h"
#include "apps/iclk/session/run_pairs.h"
#include "apps/iclk/stereo/run.h"

namespace iclk {
namespace {

struct StereoCommand {
  StereoRunOptions run;
  std::string input, left, right, depth, calibration, solver = "device", depth_sigma = "auto";
  bool unknown_depth = false;
  double rotation = 0.02, bending = 2;
};

const char* const kStereoFooter =
    "INPUT is a folder with left/, right/ and depth/ (of the left camera), files paired by the order of their names, or a\n"
    "JSONL manifest, a line a pair: {\"left\": \"l.png\", \"right\": \"r.png\", \"depth\": \"l.exr\" or \"features\": "
    "\"l.csv\", "
    "\"time\": 0.1}.\n"
    "All pairs share one T_rl (left camera to right camera); with --flex each has its own, and a motion between them.\n"
    "\n"
    "Written to --out: the calibration with new extrinsics, in its own format; result.json (with covariance, a line a pair);\n"
    "epipolar.png (a pair rectified before and after); with --flex series.csv.\n"
    "\n"
    "Examples:\n"
    "  iclk stereo recording --calibration camchain.yaml --out rig\n"
    "  iclk stereo --left cam0 --right cam1 --depth depth --depth-scale 1000 --calibration stereo.yml --out rig\n"
    "  iclk stereo --left cam0 --right cam1 --distance 30 --calibration mav0 --out rig\n"
    "  iclk stereo wing.jsonl --calibration camchain.yaml --flex --flex-hz 8 --out wing\n"
    "\n";

void run(const StereoCommand& command, int& exit) {
  StereoRunOptions options = command.run;
  options.calibration = load_stereo(command.calibration);
  const bool folders = !command.left.empty() || !command.right.empty();
  if (folders == !command.input.empty()) throw Error(ErrorCode::invalid_argument, "give either INPUT or --left and --right");
  if (folders && (command.left.empty() || command.right.empty()))
    throw Error(ErrorCode::invalid_argument, "--left and --right belong together");
  options.pairs = folders ? list_pairs(command.left, command.right, command.depth) : list_pairs(command.input);
  options.solver = parse_solver(command.solver);
  options.depth_sigma = parse_depth_sigma(command.depth_sigma);
  options.rig.metric = !command.unknown_depth && !(options.distance > 0);
  options.rig.calibration_rotation = command.rotation * kDegree;
  options.bending.rotation = command.bending * kDegree;
  if (options.flex && !options.rig.metric)
    throw Error(ErrorCode::invalid_argument, "--flex needs metric depth: one pair does not see the scale");
  ProgressBar bar;
  const internal::Stopwatch watch;
  const StereoReport report = run_stereo(options, [&](int done, int total) {
    bar.show({.total = total, .before = 0, .done = done, .failed = 0, .seconds = watch.ms() / 1000});
  });
  bar.clear();
  if (report.cpu_unasked) spdlog::warn("no GPU with Vulkan here: running on {}", report.device);
  print(to_text(report));
  if (!options.out.empty()) print("written    " + options.out + "\n");
  exit = report.usable() ? kConverged : kDiverged;
}

}  // namespace

void add_stereo(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("stereo", "Extrinsics of a stereo rig after a shock, or while it bends");
  auto options = std::make_shared<StereoCommand>();
  StereoRunOptions& run_options = options->run;
  RigOptions& rig = run_options.rig;
  command->add_option("INPUT", options->input, "Manifest or folder")->check(not_empty)->type_name("PATH");
  command->option_defaults()->group("Input");
  command->add_option("--left", options->left, "Folder of the left images")->check(not_empty)->type_name("DIR");
  command->add_option("--right", options->right, "Folder of the right images")->check(not_empty)->type_name("DIR");
  command->add_option("--depth", options->depth, "Folder of depth images of the left camera")
      ->check(not_empty)
      ->type_name("DIR");
  command
      ->add_option("--calibration", options->calibration,
                   "Kalibr camchain, OpenCV stereo YAML (with the other of intrinsics.yml and extrinsics.yml beside it), or a "
                   "folder with EuRoC's cam0/sensor.yaml and cam1/sensor.yaml")
      ->required()
      ->check(not_empty);
  command->add_option("--depth-scale", run_options.depth_scale, "Raw units a metre of 16-bit depth; float depth is in metres");
  command->add_flag("--depth-along-ray", run_options.depth_along_ray,
                    "Depths are distances from the left camera's centre, not depths along its axis");
  command
      ->add_option("--depth-sigma", options->depth_sigma,
                   "Errors of the depth: stereo:PX,BASELINE, structured-light, rendered, or a percentage like 1.5%")
      ->capture_default_str();
  command->add_flag("--unknown-depth", options->unknown_depth,
                    "Depths only say where to begin, as those of the old calibration do; the baseline keeps its length");
  command->add_option("--distance", run_options.distance, "Scenes without depth: how far, about, m; as --unknown-depth")
      ->check(CLI::PositiveNumber);
  command->option_defaults()->group("Estimate");
  command->add_option("--count", run_options.detector.count, "Features a pair")->capture_default_str();
  command->add_option("--calibration-rotation", options->rotation, "Deviation of the old calibration, degrees")
      ->capture_default_str();
  command->add_option("--calibration-translation", rig.calibration_translation, "The same, as a share of the baseline")
      ->capture_default_str();
  command->add_option("--false-alarm", rig.false_alarm, "Probability to call a rig moved that is not")->capture_default_str();
  command->add_flag("--flex", run_options.flex, "The rig bends: T_rl of every pair");
  command->add_option("--flex-hz", run_options.bending.frequency, "Highest frequency of the bending")->capture_default_str();
  command->add_option("--flex-rotation", options->bending, "Its deviation, degrees")->capture_default_str();
  command->add_option("--flex-translation", run_options.bending.translation, "The same, m")->capture_default_str();
  command->add_option("--rate", run_options.rate, "Pairs a second, where the manifest has no time")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  command->add_option("--batch", run_options.batch, "Pairs on the device at a time")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  command->add_option("--solver", options->solver, "device, host or cpu; device: a batch needs the host once")
      ->capture_default_str();
  command->add_option("--device", run_options.device,
                      "Vulkan device: index, part of its name or UUID; default: ICLK_DEVICE, else the best");
  command->option_defaults()->group("Output");
  command->add_option("--out", run_options.out, "Folder for what is written")->type_name("DIR")->check(not_empty);
  command->footer(kStereoFooter + exit_codes_help("0 done, 14 the pairs give no rig"));
  command->callback([options, &exit] { run(*options, exit); });
}

}  // namespace iclk
