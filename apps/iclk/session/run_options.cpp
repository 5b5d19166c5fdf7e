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
                  "pyramid; auto: classical, then sd6dof-small, then sd6dof, each for the pairs that did not "
                  "converge before. ICLK_MODEL changes the default")
      ->capture_default_str()
      ->check(not_empty)
      ->type_name("FILE|classical|auto");
}

void RunOptions::add_to(Settings& settings) {
  RefinerOptions& refiner = chosen.refiner;
  settings.add("levels", chosen.levels, "1 to 12", "4, or the model's", "pyramid levels, each of twice the motion");
  settings.add("iterations", chosen.iterations, "1 to 1000", "10, or the model's", "ICLK's of a level, at most");
  settings.add("carry", chosen.carry, "0 to 1", "0, or the model's", "share of a level's pose that is the next one's prior");
  settings.add("robust", chosen.robust, "unit|huber|tukey|cauchy", "huber, with a model unit", "weights of the residuals");
  settings.add("damping", chosen.damping, "fixed|adaptive", "fixed", "adaptive: a step that raises the cost is taken back");
  settings.add("search", chosen.search, "auto|on|off", "auto", "match the features first; auto: where there is no first guess");
  settings.add("photometric", chosen.photometric, "yes|no", "yes, with a model no", "estimate the pair's gain and bias");
  settings.add("dense", chosen.dense, "yes|no", "no", "align every pixel with depth, not patches");
  settings.add("refine", chosen.refine, "yes|no", "yes", "no: stop after ICLK");
  settings.add("refine-rounds", refiner.rounds, "1 to 100", "3", "of feature alignment and pose, at most");
  settings.add("recolour", refiner.feature_alignment.recolour, "yes|no", "yes", "see other colours in grey values that fit");
  settings.add("rolling-shutter", refiner.rolling_shutter, "yes|no", "yes", "take out what bends one image against the other");
  settings.add("camera-sigma", refiner.pose.camera_sigma, "PX|auto", "auto", "how wrong focal length and principal point are");
  settings.add("structure", refiner.structure, "yes|no", "no", "refine the inverse depths with the pose at the end");
}

SessionOptions RunOptions::session() const {
  SessionOptions options = chosen;
  options.solver = options.device == "cpu" ? Solver::cpu : parse_solver(solver);
  options.stages = make_stages(options);
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
  command.add_option("--count", features.count, "Features to choose; the paper has 50")->capture_default_str();
}

void LoadOptions::add_to(Settings& settings) {
  settings.add("detector", features.detector, "shi-tomasi|grid|random", "shi-tomasi", "how features are chosen");
  settings.add("seed", features.seed, "0 to 2^53", "0", "of the random detector");
  settings.add("max-pixels", max_pixels, "1 to 2^53", std::to_string(kMaxPixels), "larger images are refused by their headers");
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
  if (max_pixels < 1) throw Error(ErrorCode::invalid_argument, "--set max-pixels=0: at least 1 expected");
  options.max_pixels = max_pixels;
  options.detector = features;
  options.detector.check();
  return options;
}

void report_device(const Session& session) {
  if (session.cpu_unasked())
    spdlog::warn("no GPU with Vulkan here: running on the CPU device {} (--device {} takes it without this notice)",
                 session.device_name(), session.device_name().substr(0, session.device_name().find(' ')));
}

}  // namespace iclk
