#include "apps/iclk/session/run_options.h"

#include <spdlog/spdlog.h>

#include <iclk/engine/error.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/not_empty.h"

namespace iclk {

void RunOptions::add_to(CLI::App& command) {
  command
      .add_option(
          "--solver", solver,
          "host: sums on the device, 6x6 system on the host; device: all on the device; cpu: all on the CPU, without Vulkan")
      ->capture_default_str()
      ->check(CLI::IsMember({"host", "device", "cpu"}));
  command.add_option(
      "--device", chosen.device,
      "Vulkan device: index, UUID or part of the name (see `iclk devices`); default: ICLK_DEVICE, else the best. cpu: the "
      "same as --solver cpu");
  command
      .add_option("--model", chosen.model,
                  "auto: classical, then sd6dof-small, then sd6dof, each for the pairs that did not converge before; "
                  "classical: grey values, no network; or the name or file of a learned model. ICLK_MODEL changes the default")
      ->capture_default_str()
      ->check(not_empty)
      ->type_name("FILE|classical|auto");
}

void RunOptions::add_to(Settings& settings) {
  RefinerOptions& refiner = chosen.refiner;
  settings.add("levels", chosen.levels, "1 to 12", "4, or the model's",
               "pyramid levels; each doubles the motion that is found");
  settings.add("iterations", chosen.iterations, "1 to 1000", "10, or the model's", "most ICLK iterations per level");
  settings.add("carry", chosen.carry, "0 to 1", "0, or the model's", "share of the pose information passed to the next level");
  settings.add("robust", chosen.robust, "unit|huber|tukey|cauchy", "huber, with a model unit", "weights of the residuals");
  settings.add("damping", chosen.damping, "fixed|adaptive", "fixed", "adaptive: undo steps that raise the cost");
  settings.add("search", chosen.search, "auto|on|off", "auto", "match the features first; auto: if there is no first guess");
  settings.add("photometric", chosen.photometric, "yes|no", "yes, with a model no", "estimate the pair's gain and bias");
  settings.add("dense", chosen.dense, "yes|no", "no", "align all pixels that have depth, instead of patches");
  settings.add("refine", chosen.refine, "yes|no", "yes", "no: stop after ICLK");
  settings.add("refine-rounds", refiner.rounds, "1 to 100", "3", "most rounds of feature alignment and pose");
  settings.add("recolour", refiner.feature_alignment.recolour, "yes|no", "yes",
               "if colours differ, find the grey conversion that fits");
  settings.add("rolling-shutter", refiner.rolling_shutter, "yes|no", "yes",
               "correct for a rolling shutter, if features prove one");
  settings.add("camera-sigma", refiner.pose.camera_sigma, "PX|auto", "auto",
               "standard deviation of focal length and principal point");
  settings.add("structure", refiner.structure, "yes|no", "no", "at the end refine inverse depths together with the pose");
}

SessionOptions RunOptions::session() const {
  SessionOptions options = chosen;
  options.solver = options.device == "cpu" ? Solver::cpu : parse_solver(solver);
  options.stages = make_stages(options);
  return options;
}

void LoadOptions::add_to(CLI::App& command, bool camera_required) {
  auto* option = command.add_option(
      "--camera", camera,
      "fx,fy,cx,cy[,width,height] in pixels (pixel centres at whole numbers), or a file: camera.txt, YAML of Kalibr, "
      "EuRoC, OpenCV or ROS, or COLMAP. Scaled to images of another size with the same aspect ratio");
  if (camera_required) option->required();
  command.add_option(
      "--distortion", distortion,
      "radtan:k1,k2,p1,p2[,k3[,k4,k5,k6]], equidistant:k1,k2,k3,k4 or none; default: from the camera file. Images, depth and "
      "features are undistorted when read; all pixels in the output are pixels of the undistorted images");
  command.add_option(
      "--depth-scale", depth_scale,
      "Raw units per metre of 16-bit depth (TUM RGB-D: 5000, millimetres: 1000); default: from camera.txt. Float "
      "depth is in metres");
  command.add_flag(
      "--depth-along-ray", depth_along_ray,
      "Depths (also of features) are distances from the camera centre, as of laser scanners and some simulators, not "
      "depths along the optical axis");
  command
      .add_option("--depth-sigma", depth_sigma,
                  "Error of depths without a sigma of their own: auto (estimated from the pair), 1.5% (of the depth), "
                  "stereo:PX,BASELINE (sigma of the disparity in px, baseline in m), structured-light, or rendered (exact)")
      ->capture_default_str();
  command
      .add_option("--mask", mask,
                  "Mask of both images, of their size: pixels that are 0 are ignored, for example your own vehicle or a border")
      ->check(not_empty)
      ->type_name("FILE");
  command.add_option("--count", features.count, "Features to choose (the paper uses 50)")->capture_default_str();
}

void LoadOptions::add_to(Settings& settings) {
  settings.add("detector", features.detector, "shi-tomasi|grid|random", "shi-tomasi", "how to choose features");
  settings.add("seed", features.seed, "0 to 2^53", "0", "seed of the random detector");
  settings.add("max-pixels", max_pixels, "1 to 2^53", std::to_string(kMaxPixels),
               "larger images are rejected, before they are decoded");
}

InputOptions LoadOptions::input() const {
  InputOptions options;
  options.camera = load_camera(camera);
  if (!distortion.empty()) options.distortion = parse_distortion(distortion);
  if (depth_scale != 0 && !(std::isfinite(depth_scale) && depth_scale > 0))
    throw Error(ErrorCode::invalid_argument,
                "--depth-scale " + std::to_string(depth_scale) + " must be positive: raw units per metre, 1000 for mm");
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
    spdlog::warn("no GPU with Vulkan found: running on the CPU device {} (--device {} hides this warning)",
                 session.device_name(), session.device_name().substr(0, session.device_name().find(' ')));
}

}  // namespace iclk
