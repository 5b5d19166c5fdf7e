#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/depth/depth_sweep.h>
#include <iclk/session/device.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/commands/program.h"
#include "apps/iclk/common/cpu_stopwatch.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/common/settings.h"
#include "apps/iclk/depth/figures.h"
#include "apps/iclk/depth/input.h"
#include "apps/iclk/depth/output.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/undistorter.h"

namespace iclk {
namespace {

struct DepthCommand {
  DepthFiles files;
  DepthOptions options;
  int planes = 0;
  std::string device, out, truth;
  double truth_scale = 0, memory = 0;
  bool json = false, fill = false, peers = false, profile = false;
  Settings settings;
};

const char* const kDepthFooter =
    "Poses are T_10: they map points of REF's camera into TARGET's, X_1 = R X_0 + t, in metres.\n"
    "\n"
    "Written to --out: depth.tiff and depth.exr (32-bit float metres, 0: none), depth.png (16 bit; its scale is printed),\n"
    "confidence.png, colour.png and cloud.ply.\n"
    "\n"
    "The exit code rates the map; the files are written in every case:\n"
    "   0 converged      the images support the map\n"
    "  11 low_overlap    the targets see hardly anything of REF\n"
    "  12 degenerate     hardly any depth matches better than the others, as with a wrong pose\n"
    "  14 diverged       most of the given depths contradict the map\n"
    "\n"
    "Examples:\n"
    "  iclk depth left.png right.png --camera 994.978,994.978,311.193,254.877 \\\n"
    "    --target-camera 994.978,994.978,342.279,254.877 --pose '-0.193001 0 0 0 0 0 1' --depth-range 2,6 --out depth\n"
    "  iclk align a.png b.png --features points.csv --camera camera.txt --json > result.json\n"
    "  iclk depth a.png b.png --camera camera.txt --result result.json --out depth\n"
    "  iclk depth a.png b.png c.png --camera camera.txt --poses poses.txt --features points.csv --out depth\n"
    "\n";

nlohmann::ordered_json to_json(const DepthFigures& f) {
  return {{"bad_2", f.bad_2},
          {"bad_1", f.bad_1},
          {"bad_2_of_answers", f.bad_2_of_answers},
          {"median_relative_error", f.median_error},
          {"completeness", f.completeness},
          {"seen", f.seen},
          {"completeness_of_seen", f.seen_answered},
          {"known", f.known}};
}

/// Empty where none is given.
cv::Mat load_truth(const DepthCommand& command, const DepthInput& input) {
  if (command.truth.empty()) return {};
  const cv::Mat truth = load_depth(command.truth, command.truth_scale);
  require_size(truth, command.truth, input.reference, command.files.reference);
  return input.lens ? input.lens->depth(truth) : truth;
}

DepthPlan plan_of(const DepthCommand& command, const DepthInput& input) {
  DepthPlan plan{input.camera.width, input.camera.height, command.planes, static_cast<int>(input.targets.size())};
  if (!(command.memory >= 0 && command.memory < 1e9))
    throw Error(ErrorCode::invalid_argument, fmt::format("--memory {}: must be megabytes, 0 or more", command.memory));
  plan.most_bytes = static_cast<uint64_t>(1e6 * command.memory);
  if (plan.planes == 0) plan.planes = planes_for(input.camera, input.cameras, input.T_10, input.range);
  plan.check();
  return plan;
}

void run_depth(const DepthCommand& command, DepthPeers peers, int& exit) {
  if (command.peers && !peers) throw NeedsProgram{"peers"};
  command.options.check();
  if (!command.out.empty()) make_output_folder(command.out);
  const DepthInput input = load_depth_input(command.files);
  const cv::Mat truth = load_truth(command, input);
  const DepthPlan plan = plan_of(command, input);
  const auto context = open_device(command.device);
  if (context->cpu_unasked()) spdlog::warn("no GPU with Vulkan found: running on {}", context->info().name);
  DepthOptions options = command.options;
  options.keep_unseen = options.keep_unseen || command.fill;
  DepthSweep sweep(context, plan, options);
  std::vector<DepthSource> sources;
  for (size_t i = 0; i < input.targets.size(); ++i)
    sources.push_back({view(input.targets[i]), input.cameras[i], input.T_10[i]});

  if (command.peers) sweep.compute(view(input.reference), input.camera, sources, input.range, input.priors);  // warm
  const internal::Stopwatch wall_time;
  const CpuStopwatch cpu_time;
  DepthMap map = sweep.compute(view(input.reference), input.camera, sources, input.range, input.priors);
  const double cpu = cpu_time.ms() / 1000, wall = wall_time.ms() / 1000;

  const double step = (1 / input.range.near - 1 / input.range.far) / (plan.planes - 1);
  if (input.priors.size() == 0) compare(map, input.measured, options.tolerance * step);
  if (command.fill) fill(map);
  const cv::Mat depth = depth_image(map);
  nlohmann::ordered_json json = {
      {"schema", "iclk-depth-1"},      {"status", name(map.status)}, {"reason", map.reason},   {"seen", map.seen},
      {"agreeing", map.agreeing},      {"width", plan.width},        {"height", plan.height},  {"planes", plan.planes},
      {"views", plan.views},           {"near", input.range.near},   {"far", input.range.far}, {"valid", map.valid},
      {"png_scale", png_scale(depth)}, {"strips", sweep.strips()},   {"seconds", wall},        {"cpu_seconds", cpu},
      {"device", context->info().name}};
  std::string text =
      fmt::format("depth      {}x{}, {} views, {} planes from {:.4g} to {:.4g} m\nvalid      {:.1f} %\n", plan.width,
                  plan.height, plan.views, plan.planes, input.range.near, input.range.far, 100 * map.valid);
  text += fmt::format("time       {:.0f} ms, {:.2f} CPU-s on {}\n", 1000 * wall, cpu, context->info().name);
  const auto judge = [&](const cv::Mat& answer) {
    return depth_figures(answer, truth, input.camera, input.cameras, input.T_10);
  };
  if (!truth.empty()) {
    const DepthFigures figures = judge(depth);
    json["truth"] = to_json(figures);
    text += "truth      " + to_text(figures) + "\n";
  }
  if (command.peers) {
    json["peers"] = nlohmann::ordered_json::array();
    for (DepthPeer& peer : peers(input)) {
      if (command.fill) fill_depth(peer.depth);
      nlohmann::ordered_json entry = {{"name", peer.name}, {"cpu_seconds", peer.cpu_s}};
      text += fmt::format("{:<18} {:.2f} CPU-s", peer.name, peer.cpu_s);
      if (!truth.empty()) {
        const DepthFigures figures = judge(peer.depth);
        entry["truth"] = to_json(figures);
        text += ", " + to_text(figures);
      }
      json["peers"].push_back(entry);
      text += "\n";
    }
  }
  if (command.profile)
    for (const engine::StageTime& stage : sweep.times())
      spdlog::info("{:<12} {:8.1f} ms", stage.name, stage.milliseconds / stage.count);
  if (!command.out.empty())
    text += fmt::format("written    {} in {}; depth.png has {:g} units per metre\n",
                        write_depth(command.out, map, input.reference, input.camera), command.out, png_scale(depth));
  text += fmt::format("status     {}: {}\n", name(map.status), map.reason);
  print(command.json ? json.dump(2) + "\n" : text);
  exit = exit_code(map.status);
}

void add_input(CLI::App* command, DepthFiles& files) {
  command->option_defaults()->group("Input");
  command->add_option("--camera", files.camera, "fx,fy,cx,cy[,width,height] or a camera file, as for `iclk align`")
      ->required()
      ->check(not_empty);
  command->add_option("--target-camera", files.target_camera, "Camera of the targets, if it differs from --camera")
      ->check(not_empty);
  command->add_option("--distortion", files.distortion,
                      "radtan:k1,k2,p1,p2[,k3], equidistant:k1,k2,k3,k4 or none; default: from the camera file");
  command
      ->add_option("--pose", files.poses,
                   "T_10 of a target: 'tx ty tz qx qy qz qw', a matrix, or a file with one; repeat it for each target")
      ->check(not_empty)
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll)
      ->type_name("POSE");
  command->add_option("--poses", files.pose_file, "File with one T_10 per line, in the order of the targets")
      ->check(not_empty)
      ->type_name("FILE");
  command
      ->add_option("--result", files.result,
                   "result.json of `iclk align`: gives the pose, and the depths of its features as priors")
      ->check(not_empty)
      ->type_name("FILE");
  command
      ->add_option("--features", files.features,
                   "Sparse depths of REF, as a CSV file for `iclk align`: priors, and the default of --depth-range")
      ->check(not_empty)
      ->type_name("FILE");
  command
      ->add_option("--depth", files.depth,
                   "Depth image of REF, to compare the map with; also the last resort for --depth-range")
      ->check(not_empty)
      ->type_name("FILE");
  command->add_option("--depth-scale", files.depth_scale, "Raw units per metre of a 16-bit --depth; float depth is in metres");
  command->add_flag("--depth-along-ray", files.depth_along_ray,
                    "Depths (also of features) are distances from the camera centre, not depths along the optical axis");
  command
      ->add_option("--depth-range", files.range,
                   "Depths to search, in metres; default: the range of the sparse depths, with a margin")
      ->check(not_empty)
      ->type_name("NEAR,FAR");
}

void add_settings(DepthOptions& sweep, Settings& settings) {
  settings.add("p1", sweep.p1, "COST", "7", "penalty if neighbours differ by one plane");
  settings.add("p2", sweep.p2, "COST", "60", "penalty if neighbours differ by more");
  settings.add("edge", sweep.edge, "0 to 255", "3", "reduction of p2 per grey level of difference");
  settings.add("uniqueness", sweep.uniqueness, "0 to 1", "0.01", "share by which the second-best plane must be worse");
  settings.add("tolerance", sweep.tolerance, "PLANES", "3", "largest difference between the views");
  settings.add("iterations", sweep.iterations, "0 to 20", "3", "refinement steps between planes");
  settings.add("speckle", sweep.speckle, "PIXELS", "100", "smaller islands are removed");
}

}  // namespace

void add_depth(CLI::App& app, int& exit) { add_depth(app, exit, nullptr); }

void add_depth(CLI::App& app, int& exit, DepthPeers peers) {
  CLI::App* command = app.add_subcommand("depth", "Compute a dense depth map of an image from other images with known poses");
  auto options = std::make_shared<DepthCommand>();
  DepthFiles& files = options->files;
  DepthOptions& sweep = options->options;
  command->add_option("REF", files.reference, "Image to compute the depth of")->required()->check(not_empty)->type_name("FILE");
  command->add_option("TARGET", files.targets, "Images of the same scene, 1 to 8")
      ->required()
      ->expected(1, 8)
      ->check(not_empty)
      ->type_name("FILE");
  add_input(command, files);
  command->option_defaults()->group("Matching");
  command
      ->add_option("--planes", options->planes,
                   "Planes of inverse depth, a multiple of 16; 0: one per pixel of motion, at most 256")
      ->capture_default_str();
  command->add_option("--device", options->device,
                      "Vulkan device: index, UUID or part of the name; default: ICLK_DEVICE, else the best");
  command
      ->add_option("--memory", options->memory,
                   "Most device memory, in MB: larger images are computed in strips; default: all that the device has")
      ->type_name("MB");
  command->add_flag("--keep-unseen", sweep.keep_unseen,
                    "Keep pixels that no target sees: their depth follows from their neighbours, with confidence 0");
  command->add_flag("--fill", options->fill,
                    "Fill pixels without depth with the depth of the background around them, also in maps of --peers");
  add_settings(sweep, options->settings);
  options->settings.add_to(*command);
  command->option_defaults()->group("Output");
  command->add_option("--out", options->out, "Folder for the results")->type_name("DIR")->check(not_empty);
  command->add_option("--truth", options->truth, "True depth of REF: also prints the errors")
      ->check(not_empty)
      ->type_name("FILE");
  command->add_option("--truth-scale", options->truth_scale, "Raw units per metre of a 16-bit --truth");
  command->add_flag("--peers", options->peers, "Also run OpenCV's stereo methods, on the rectified pair");
  command->add_flag("--json", options->json, "Print only the summary, as JSON, on standard output");
  command->add_flag("--profile", options->profile, "Print the device time of each stage on standard error");
  command->footer(options->settings.help() + kDepthFooter +
                  exit_codes_help("0 converged, 11 low_overlap, 12 degenerate, 14 diverged"));
  command->callback([options, peers, &exit] { run_depth(*options, peers, exit); });
}

}  // namespace iclk
