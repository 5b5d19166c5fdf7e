#include "apps/iclk/session/run_options.h"

#include <spdlog/spdlog.h>

#include <iclk/engine/error.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/not_empty.h"

namespace iclk {

void RunOptions::add_to(CLI::App& command) {
  command
      .add_option("--solver", solver,
                  "host: sums on the device, 6x6 system on the host; device: everything on the device; cpu: no Vulkan")
      ->capture_default_str()
      ->check(CLI::IsMember({"host", "device", "cpu"}));
  command.add_option(
      "--device", chosen.device,
      "Vulkan device: index, part of the name or UUID (see `iclk devices`); default ICLK_DEVICE, else the best. cpu: none, "
      "as --solver cpu");
  command
      .add_option("--model", chosen.model,
                  "A learned model, file or name (`iclk model info`): its encoder and its weights; classical: the grey "
                  "pyramid and --robust; auto: classical, then sd6dof-small, then sd6dof, each for the pairs that did not "
                  "converge before. ICLK_MODEL changes the default")
      ->capture_default_str()
      ->check(not_empty)
      ->type_name("FILE|classical|auto");
  command.add_option(
      "--levels", chosen.levels,
      "Pyramid levels: each doubles the motion that can be found; default 4, or all that the model has (fewer: its "
      "finest)");
  command.add_option("--iterations", chosen.iterations, "Iterations a level, at most; default 10, or the model's");
  command.add_option("--carry", chosen.carry,
                     "Share (0 to 1) of what a level has found out about the pose that the next finer one keeps as a prior: "
                     "blurred and noisy images need it; default 0, the paper's, or the model's");
  command
      .add_option("--robust", robust,
                  "Weights of the residuals; unit is the paper's. huber, tukey and cauchy play down what moved by itself; "
                  "default huber, with a model unit")
      ->check(CLI::IsMember({"unit", "huber", "tukey", "cauchy"}));
  command
      .add_option("--damping", damping,
                  "fixed: every step is taken, as in the paper; adaptive: a step that raises the cost is taken back")
      ->capture_default_str()
      ->check(CLI::IsMember({"fixed", "adaptive"}));
  command
      .add_option("--search", search,
                  "How to begin. on: look for the features in the whole target, whatever the motion; off: at the first guess; "
                  "auto: on where no first guess is given")
      ->capture_default_str()
      ->check(CLI::IsMember({"auto", "on", "off"}));
  // Not bound to `photometric` itself: CLI11 2.1 sets an optional<bool> to false where the flag is not given.
  command.add_flag_function(
      "--photometric,!--no-photometric", [this](std::int64_t count) { chosen.photometric = count > 0; },
      "Estimate the pair's exposure (gain and bias), or do not; default: do, but not with a model");
  command.add_flag("--dense", chosen.dense,
                   "Align every pixel with depth instead of 8x8 patches; refinement works on the features");
  command.add_flag_callback(
      "--no-refine", [this] { chosen.refine = false; }, "Stop after ICLK: no feature alignment, no pose refinement");
  command.add_option("--refine-rounds", chosen.refiner.rounds, "Rounds of feature alignment and pose, at most")
      ->capture_default_str();
  command.add_flag_callback(
      "--no-recolour", [this] { chosen.refiner.feature_alignment.recolour = false; },
      "Refine on the luma of a target whose colours are not the reference's, not on the grey values that fit the reference");
  command.add_flag_callback(
      "--global-shutter", [this] { chosen.refiner.rolling_shutter = false; },
      "Both cameras read all rows at once: no bend is looked for, and the covariance does not allow for one");
  command
      .add_option("--camera-sigma", camera_sigma,
                  "How wrong focal length and principal point are, px, for the covariance: auto (what the pair allows for), or "
                  "a number; 0 where they are exact, as a renderer's")
      ->capture_default_str();
  command.add_flag("--structure", chosen.refiner.structure, "Refine the inverse depths along with the pose at the end");
}

SessionOptions RunOptions::session() const {
  SessionOptions options = chosen;
  options.solver = options.device == "cpu" ? Solver::cpu : parse_solver(solver);
  options.search = parse_search(search);
  options.damping = parse_damping(damping);
  if (robust) options.robust = parse_robust(*robust);
  options.stages = make_stages(options);
  if (camera_sigma == "auto") return options;
  options.refiner.pose.camera_sigma = to_number(camera_sigma);
  if (!options.refiner.pose.camera_sigma)
    throw Error(ErrorCode::invalid_argument,
                "--camera-sigma '" + printable(camera_sigma) + "' is neither auto nor a number of px");
  return options;
}

void LoadOptions::add_to(CLI::App& command, bool camera_required) {
  auto* option =
      command.add_option("--camera", camera,
                         "fx,fy,cx,cy[,width,height] in pixels, pixel centres at whole numbers; or a file: camera.txt line, "
                         "Kalibr / EuRoC YAML, OpenCV / ROS YAML. Scaled if the images have another size of the same aspect");
  if (camera_required) option->required();
  command.add_option(
      "--distortion", distortion,
      "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: the camera file's. Images, depth and features are "
      "undistorted when read; every pixel in the output is of the undistorted images");
  command.add_option("--depth-scale", depth_scale,
                     "Raw units a metre of 16-bit depth (TUM RGB-D 5000, millimetres 1000); default: camera.txt's. Float depth "
                     "is in metres");
  command.add_flag(
      "--depth-along-ray", depth_along_ray,
      "Depths, those of features too, are distances from the camera's centre (laser scanners, some simulators), not "
      "depths along its axis");
  command
      .add_option("--depth-sigma", depth_sigma,
                  "How wrong depths are, where features bring no sigma: auto (estimated from the pair), 1.5% (of the depth), "
                  "stereo:PX,BASELINE (sigma of the disparity, metres), structured-light, rendered (exact)")
      ->capture_default_str();
  command
      .add_option("--mask", mask,
                  "An image of the pairs' size that is 0 where both images are not to be looked at: the own vehicle, a border")
      ->check(not_empty)
      ->type_name("FILE");
  command
      .add_option("--max-pixels", max_pixels,
                  "Most pixels of an image: a larger one is refused by its header, before its pixels take memory")
      ->capture_default_str()
      ->check(CLI::Range(uint64_t{1}, uint64_t{1} << 40));
  command
      .add_option("--detector", detector,
                  "How features are chosen where no feature file is given: shi-tomasi (corners, spread over the "
                  "image), grid, random (uniform, as in the paper)")
      ->capture_default_str()
      ->check(CLI::IsMember({"shi-tomasi", "grid", "random"}));
  command.add_option("--count", features.count, "Features to choose; the paper has 50")->capture_default_str();
  command.add_option("--seed", features.seed, "Seed of --detector random")->capture_default_str();
}

InputOptions LoadOptions::input() const {
  InputOptions options;
  options.camera = load_camera(camera);
  if (!distortion.empty()) options.distortion = parse_distortion(distortion);
  if (depth_scale != 0 && !(std::isfinite(depth_scale) && depth_scale > 0))
    throw Error(ErrorCode::invalid_argument, "--depth-scale " + std::to_string(depth_scale) + " must be positive");
  options.depth_scale = depth_scale;
  options.depth_along_ray = depth_along_ray;
  options.depth_sigma = parse_depth_sigma(depth_sigma);
  options.mask = mask;
  options.max_pixels = max_pixels;
  options.detector = features;
  options.detector.detector = parse_detector(detector);
  options.detector.check();
  return options;
}

void report_device(const Session& session) {
  if (session.cpu_unasked())
    spdlog::warn("no GPU with Vulkan here: running on the CPU device {} (--device {} takes it without this notice)",
                 session.device_name(), session.device_name().substr(0, session.device_name().find(' ')));
}

}  // namespace iclk
