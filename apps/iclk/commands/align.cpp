#include <spdlog/spdlog.h>

#include <iclk/session/io/output.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"
#include "apps/iclk/pictures/result_files.h"
#include "apps/iclk/session/report.h"
#include "apps/iclk/session/run_options.h"

namespace iclk {
namespace {

struct AlignOptions {
  PairFiles files;
  LoadOptions load;
  RunOptions run;
  Settings settings;
  std::string initial_pose, truth, out;
  bool json = false, profile = false;
};

const char* const kAlignFooter =
    "Poses are T_10: they map points of camera 0 (REF) into camera 1 (TARGET), X_1 = R X_0 + t. A pose is a TUM line\n"
    "'tx ty tz qx qy qz qw' (a timestamp before it is ignored) or a 4x4 matrix row by row, as text or in a file.\n"
    "\n"
    "Examples:\n"
    "  iclk align a.png b.png --depth a_depth.png --depth-scale 5000 --camera 517.3,516.5,318.6,255.3 --out result\n"
    "  iclk align a.png b.png --depth a_depth.exr --camera calibration.yaml --truth '0.01 0 0 0 0 0 1'\n"
    "  iclk align a.png b.png --features points.csv --camera camchain.yaml --json > result.json\n"
    "  iclk align a.png b.png --depth a_depth.tiff --camera calibration.yaml --distortion radtan:0.26,-0.95,-0.005,0.003,1.16\n"
    "  iclk align a.png b.png --features points.csv --camera camera.txt --model model.safetensors --solver device\n"
    "  iclk align a.png b.png --depth a_depth.png --depth-scale 1000 --camera calibration.yaml --solver cpu --count 50\n"
    "  iclk align a.png b.png --depth a_depth.png --depth-scale 1000 --camera camera.txt --mask hood.png\n"
    "\n";

void run_align(const AlignOptions& options, int& exit) {
  // What needs no image is checked first: the line is typed wrong more often than a file is broken.
  SessionOptions session_options = options.run.session();
  session_options.profile = options.profile;
  const PairLoader loader(options.load.input());
  std::optional<SE3> guess, truth;
  if (!options.initial_pose.empty()) guess = load_pose(options.initial_pose, "--initial-pose");
  if (!options.truth.empty()) truth = load_pose(options.truth, "--truth");
  if (!options.out.empty()) make_output_folder(options.out);

  PairInput pair = loader.load(options.files);
  pair.T_10 = guess;
  pair.truth = truth;
  if (options.files.features.empty() && pair.features.size() < options.load.features.count)
    spdlog::warn(
        "found only {} of {} features (--count): they need depth, texture, and distance from the border and each other",
        pair.features.size(), options.load.features.count);
  Session session(session_options);
  report_device(session);
  const RefinedAlignment result = run_pair(session, pair);

  if (!options.out.empty()) write_results(options.out, pair, result, session);
  if (options.json) {
    print(json_text(pair, result, session));
  } else {
    print(to_table(pair, result, session));
    if (!options.out.empty()) print("written    result.json, features.png, overlay.png, residual.png in " + options.out + "\n");
  }
  if (options.profile) spdlog::info("stages\n{}", profile_text(session, pair));
  exit = exit_code(result.status);
}

}  // namespace

void add_align(CLI::App& app, int& exit) {
  CLI::App* command =
      app.add_subcommand("align", "Align a target image with a reference image whose depth is known, at least at some pixels");
  auto options = std::make_shared<AlignOptions>();
  command->add_option("REF", options->files.reference, "Reference image I0: grey or colour, 8-bit, 16-bit or float")
      ->required()
      ->check(not_empty)
      ->type_name("FILE");
  command->add_option("TARGET", options->files.target, "Target image I1, of the same size and camera")
      ->required()
      ->check(not_empty)
      ->type_name("FILE");
  command->option_defaults()->group("Input");
  command
      ->add_option(
          "--depth", options->files.depth,
          "Depth image of REF, registered to it: 16-bit PNG with --depth-scale, or 32-bit float TIFF or EXR in metres. "
          "Pixels without depth are 0, negative, NaN or infinite")
      ->check(not_empty)
      ->type_name("FILE");
  command
      ->add_option(
          "--features", options->files.features,
          "Features of REF: a CSV file with the header u,v,depth or u,v,inverse_depth. An optional column sigma has the "
          "standard deviation of the depth or inverse depth")
      ->check(not_empty)
      ->type_name("FILE");
  command
      ->add_option("--reference-mask", options->files.reference_mask,
                   "Mask of REF, of its size: pixels that are 0 are ignored, and features there have no depth")
      ->check(not_empty)
      ->type_name("FILE");
  command
      ->add_option("--target-mask", options->files.target_mask,
                   "Mask of TARGET, for example for moving objects or dirt on the lens")
      ->check(not_empty)
      ->type_name("FILE");
  options->load.add_to(*command, true);
  command
      ->add_option("--initial-pose", options->initial_pose,
                   "First guess of T_10; default: none, and the whole target is searched (--set search)")
      ->check(not_empty)
      ->type_name("POSE");
  command->add_option("--truth", options->truth, "True T_10: also prints the error after every stage")
      ->check(not_empty)
      ->type_name("POSE");
  command->option_defaults()->group("Alignment");
  options->run.add_to(*command);
  options->run.add_to(options->settings);
  options->load.add_to(options->settings);
  options->settings.add_to(*command);
  command->option_defaults()->group("Output");
  command->add_option("--out", options->out, "Folder for result.json, features.png, overlay.png and residual.png")
      ->check(not_empty)
      ->type_name("DIR");
  command->add_flag("--json", options->json, "Print only the result, as JSON (docs/schema/result-1.json), on standard output");
  command->add_flag("--profile", options->profile, "Print the time of each stage on standard error");
  command->footer(options->settings.help() + kAlignFooter + exit_codes_help(kStatusCodes));
  command->callback([options, &exit] { run_align(*options, exit); });
}

}  // namespace iclk
