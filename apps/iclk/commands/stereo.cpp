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
    "INPUT is a folder with left/, right/ and depth/ (of the left camera); files are paired in the order of their names. Or\n"
    "it is a JSONL manifest with one pair per line:\n"
    "  {\"left\": \"l.png\", \"right\": \"r.png\", \"depth\": \"l.exr\" or \"features\": \"l.csv\", \"time\": 0.1}\n"
    "All pairs share one T_rl (left camera to right camera). With --flex each pair has its own, linked by a motion model.\n"
    "\n"
    "Written to --out: the calibration with new extrinsics, in its own format; result.json, with the covariance and an entry\n"
    "per pair; epipolar.png, a pair rectified before and after; with --flex series.csv.\n"
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
  if (folders == !command.input.empty()) throw Error(ErrorCode::invalid_argument, "give either INPUT, or --left and --right");
  if (folders && (command.left.empty() || command.right.empty()))
    throw Error(ErrorCode::invalid_argument, "--left and --right must be given together");
  options.pairs = folders ? list_pairs(command.left, command.right, command.depth) : list_pairs(command.input);
  options.solver = parse_solver(command.solver);
  options.depth_sigma = parse_depth_sigma(command.depth_sigma);
  options.rig.metric = !command.unknown_depth && !(options.distance > 0);
  options.rig.calibration_rotation = command.rotation * kDegree;
  options.bending.rotation = command.bending * kDegree;
  if (options.flex && !options.rig.metric)
    throw Error(ErrorCode::invalid_argument, "--flex needs metric depth (--depth): the scale is not visible in a single pair");
  ProgressBar bar;
  const internal::Stopwatch watch;
  const StereoReport report = run_stereo(options, [&](int done, int total) {
    bar.show({.total = total, .before = 0, .done = done, .failed = 0, .seconds = watch.ms() / 1000});
  });
  bar.clear();
  if (report.cpu_unasked) spdlog::warn("no GPU with Vulkan found: running on {}", report.device);
  print(to_text(report));
  if (!options.out.empty()) print("written    " + options.out + "\n");
  exit = report.usable() ? kConverged : kDiverged;
}

}  // namespace

void add_stereo(CLI::App& app, int& exit) {
  CLI::App* command =
      app.add_subcommand("stereo", "Estimate the extrinsics of a stereo rig after a shock, or while the rig bends");
  auto options = std::make_shared<StereoCommand>();
  StereoRunOptions& run_options = options->run;
  RigOptions& rig = run_options.rig;
  command->add_option("INPUT", options->input, "Manifest or folder, see below; or give --left and --right")
      ->check(not_empty)
      ->type_name("PATH");
  command->option_defaults()->group("Input");
  command->add_option("--left", options->left, "Folder of the left images")->check(not_empty)->type_name("DIR");
  command->add_option("--right", options->right, "Folder of the right images")->check(not_empty)->type_name("DIR");
  command->add_option("--depth", options->depth, "Folder of depth images of the left camera")
      ->check(not_empty)
      ->type_name("DIR");
  command
      ->add_option(
          "--calibration", options->calibration,
          "Old calibration: Kalibr camchain, OpenCV stereo YAML (intrinsics.yml and extrinsics.yml in one folder; name "
          "either), or a folder with EuRoC's cam0/sensor.yaml and cam1/sensor.yaml")
      ->required()
      ->check(not_empty);
  command->add_option("--depth-scale", run_options.depth_scale,
                      "Raw units per metre of 16-bit depth; float depth is in metres");
  command->add_flag("--depth-along-ray", run_options.depth_along_ray,
                    "Depths are distances from the centre of the left camera, not depths along its optical axis");
  command
      ->add_option("--depth-sigma", options->depth_sigma,
                   "Error of the depth: auto, a percentage such as 1.5%, stereo:PX,BASELINE, structured-light, or rendered")
      ->capture_default_str();
  command->add_flag("--unknown-depth", options->unknown_depth,
                    "Use depths only as a start (for example those of the old calibration); keep the length of the baseline");
  command
      ->add_option("--distance", run_options.distance,
                   "Without depth: approximate distance of the scene, m; implies --unknown-depth")
      ->check(CLI::PositiveNumber);
  command->option_defaults()->group("Estimate");
  command->add_option("--count", run_options.detector.count, "Features per pair")->capture_default_str();
  command
      ->add_option("--calibration-rotation", options->rotation,
                   "Standard deviation of the rotation in the old calibration, degrees")
      ->capture_default_str();
  command
      ->add_option("--calibration-translation", rig.calibration_translation,
                   "Standard deviation of its translation, as a share of the baseline")
      ->capture_default_str();
  command->add_option("--false-alarm", rig.false_alarm, "Probability of reporting a move of a rig that has not moved")
      ->capture_default_str();
  command->add_flag("--flex", run_options.flex, "For a rig that bends: estimate a T_rl for every pair");
  command->add_option("--flex-hz", run_options.bending.frequency, "Highest frequency of the bending, Hz")
      ->capture_default_str();
  command->add_option("--flex-rotation", options->bending, "Standard deviation of the bending, degrees")->capture_default_str();
  command->add_option("--flex-translation", run_options.bending.translation, "Standard deviation of the bending, m")
      ->capture_default_str();
  command->add_option("--rate", run_options.rate, "Pairs per second, if the manifest has no times")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  command->add_option("--batch", run_options.batch, "Pairs that are aligned together")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  command->add_option("--solver", options->solver, "device, host or cpu; device: one round trip to the device per batch")
      ->capture_default_str();
  command->add_option("--device", run_options.device,
                      "Vulkan device: index, UUID or part of the name; default: ICLK_DEVICE, else the best");
  command->option_defaults()->group("Output");
  command->add_option("--out", run_options.out, "Folder for the results")->type_name("DIR")->check(not_empty);
  command->footer(kStereoFooter + exit_codes_help("0 done, 14 no extrinsics could be estimated"));
  command->callback([options, &exit] { run(*options, exit); });
}

}  // namespace iclk
