#include <cstdlib>

#include <spdlog/spdlog.h>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/context.h>
#include <iclk/session/device.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/pictures/result_files.h"
#include "apps/iclk/session/report.h"
#include "apps/iclk/session/run_options.h"
#include "apps/iclk/sets/rendered_pair.h"
#include "apps/iclk/sets/scene.h"

namespace iclk {
namespace {

struct DemoOptions {
  RunOptions run;
  Settings settings;
  DetectorOptions features;
  std::string out = "iclk_demo";
};

/// The device that renders: the session's, or for the CPU solver whatever there is. Null where there is no Vulkan device.
std::shared_ptr<engine::Context> rendering_device(const Session& session) {
  if (session.context()) return session.context();
  try {
    return open_device(session.options().device);
  } catch (const Error& e) {
    if (e.code() != ErrorCode::no_driver && e.code() != ErrorCode::no_device) throw;
    spdlog::warn("no Vulkan device found to render terrain: the CPU draws a small landscape instead");
    return nullptr;
  }
}

PairInput demo_pair(const Session& session, const DetectorOptions& features) {
  const internal::Stopwatch watch;
  const auto device = rendering_device(session);
  const ScenePair scene = device ? render_scene_pair(device) : make_scene_pair(demo_motion());
  PairInput pair;
  pair.name_0 = device ? "procedural terrain, rendered from 120 m above" : "a model landscape, 2 m below the camera";
  pair.name_1 = device ? "the same after a motion of 3 degrees and 3.6 m, darker"
                       : "the same after a motion of 3 degrees and 6 cm, darker";
  pair.image_0 = scene.image_0;
  pair.image_1 = scene.image_1;
  pair.depth_0 = scene.depth_0;
  pair.camera = scene.camera;
  pair.truth = scene.T_10;
  pair.load_ms = watch.ms();
  detect_missing_features(pair, features);
  return pair;
}

void run_demo(const DemoOptions& options, int& exit) {
  const SessionOptions session_options = options.run.session();
  make_output_folder(options.out);
  Session session(session_options);
  report_device(session);
  const PairInput pair = demo_pair(session, options.features);
  const RefinedAlignment result = run_pair(session, pair);
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
      "demo", "Render two views of procedural terrain, align them, compare with the true motion, and draw the result");
  auto options = std::make_shared<DemoOptions>();
  command->add_option("--out", options->out, "Folder for the pictures and result.json")
      ->capture_default_str()
      ->type_name("DIR");
  command->add_option("--count", options->features.count, "Features to choose")->capture_default_str();
  options->run.add_to(*command);
  options->run.add_to(options->settings);
  options->settings.add_to(*command);
  command->footer(options->settings.help() + "Examples:\n  iclk demo\n  iclk demo --solver cpu --count 50 --out demo50\n\n" +
                  exit_codes_help(kStatusCodes));
  command->callback([options, &exit] { run_demo(*options, exit); });
}

}  // namespace iclk
