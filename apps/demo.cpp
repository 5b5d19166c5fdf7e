#include <chrono>

#include <spdlog/spdlog.h>

#include "apps/command.h"
#include "apps/io/images.h"
#include "apps/io/output.h"
#include "apps/report.h"
#include "apps/result_files.h"
#include "apps/run_options.h"
#include "apps/scene.h"

namespace iclk {
namespace {

struct DemoOptions {
  RunOptions run;
  DetectorOptions features;
  std::string out = "iclk_demo";
};

PairInput demo_pair(const DetectorOptions& features) {
  const auto start = std::chrono::steady_clock::now();
  const ScenePair scene = make_scene_pair(demo_motion());
  PairInput pair;
  pair.name_0 = "a model landscape, 2 m below the camera";
  pair.name_1 = "the same after a motion of 3 degrees and 6 cm, darker";
  pair.image_0 = scene.image_0;
  pair.image_1 = scene.image_1;
  pair.depth_0 = scene.depth_0;
  pair.camera = scene.camera;
  pair.truth = scene.T_10;
  pair.load_ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  detect_missing_features(pair, features);
  return pair;
}

void run_demo(const DemoOptions& options, int& exit) {
  const SessionOptions session_options = options.run.session();
  make_output_folder(options.out);
  Session session(session_options);
  report_device(session);
  const PairInput pair = demo_pair(options.features);
  const RefinedAlignment result = session.run(pair);
  write_file(options.out + "/reference.png", encode_png(pair.image_0));
  write_file(options.out + "/target.png", encode_png(pair.image_1));
  write_results(options.out, pair, result, session);
  print(to_table(pair, result, session));
  print("\nLook at " + options.out + "/overlay.png first: colour fringes are where the images disagree.\n" +
        "Also there: features.png, residual.png, reference.png, target.png, result.json\n");
  exit = exit_code(result.status);
}

}  // namespace

void add_demo(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand(
      "demo", "Align two views of a landscape made in code, whose true motion is known, and draw the result");
  auto options = std::make_shared<DemoOptions>();
  command->add_option("--out", options->out, "Folder for the pictures and result.json")
      ->capture_default_str()
      ->type_name("DIR");
  command->add_option("--count", options->features.count, "Features")->capture_default_str();
  options->run.add_to(*command);
  command->footer(std::string("Examples:\n  iclk demo\n  iclk demo --solver cpu --count 200 --out demo200\n\n") +
                  kExitCodesHelp);
  command->callback([options, &exit] { run_demo(*options, exit); });
}

}  // namespace iclk
