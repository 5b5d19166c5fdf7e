#include <iclk/session/io/output.h>

#include "apps/eval/commands.h"
#include "apps/eval/locate/run.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/not_empty.h"

namespace iclk {
namespace {

struct LocateEvalCommand {
  LocateEvalOptions options;
  std::string out, heading = "known";
  std::vector<double> prior = {25, 15};
};

const char* const kLocateEvalFooter =
    "Frames are rendered from ground, and located on a degraded copy of it: coarser, with noise, seams, other light, missing\n"
    "houses, cars and a cloud, drawn from --seed. Priors are off by a fixed distance and angle.\n"
    "  texels  mean distance on the ground between where the pixels are and where the pose puts them, in texels of the mosaic\n"
    "  wrong   converged, and more than 3 texels off\n"
    "  over 2° converged, and turned by more than 2 degrees: a shift of the camera then hides the turn on the ground\n"
    "  NEES    squared pose error normalised by the covariance; its median is 5.35 if the covariance is right\n"
    "\n"
    "Examples:\n"
    "  iclk eval locate --out frames.jsonl\n"
    "  iclk eval locate --prior 10,5 --season --seed 7\n"
    "  iclk eval locate --ortho map.tif --elevation dsm.tif --maps 4 --peers --export pairs\n"
    "\n";

void run(LocateEvalCommand& command, int& exit) {
  LocateEvalOptions& o = command.options;
  o.metres = command.prior[0], o.degrees = command.prior[1];
  o.heading = command.heading == "known";
  o.locator.session.device = o.device;
  const LocateEval eval = run_locate_eval(o, terminal_progress());
  if (!command.out.empty()) write_file(command.out, to_lines(eval));
  print(to_table(eval));
  exit = kConverged;
}

}  // namespace

void add_locate_eval(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("locate", "Measure how frames are located on degraded maps");
  auto o = std::make_shared<LocateEvalCommand>();
  LocateEvalOptions& e = o->options;
  command->add_option("--frames", e.frames, "Frames to locate")->capture_default_str();
  command->add_option("--maps", e.maps, "Maps that they are spread over")->capture_default_str();
  command->add_option("--seed", e.seed, "Seed of ground, defects, frames and priors")->capture_default_str();
  command->add_option("--ortho", e.ortho, "The ground: GeoTIFF, 8 bit; default: procedural")
      ->type_name("FILE")
      ->check(not_empty);
  command->add_option("--elevation", e.elevation, "Its heights: GeoTIFF, metres")->type_name("FILE")->check(not_empty);
  command->add_flag("--perfect", e.perfect, "The map is the ground, without defects but those of --texel");
  command->add_flag("--season", e.season, "The map shows procedural ground in another season, under another sun");
  command->add_option("--texel", e.texel, "Metres per pixel of the mosaic; default: 2 to 6 times those of a frame");
  command->add_option("--prior", o->prior, "METRES,DEGREES that priors are off; their sigma is half of it. Default 25,15")
      ->delimiter(',')
      ->expected(2)
      ->type_name("METRES,DEGREES");
  command->add_option("--elsewhere", e.elsewhere, "Metres that priors are off in addition: most claims are then wrong")
      ->type_name("METRES");
  command->add_option("--heading", o->heading, "known or unknown")
      ->check(CLI::IsMember({"known", "unknown"}))
      ->capture_default_str();
  command->add_option("--model", e.locator.session.model, "auto, classical, or a learned model, as in `iclk align`")
      ->capture_default_str();
  command->add_option("--device", e.device, "Vulkan device: index, part of its name or UUID");
  command->add_flag("--peers", e.peers, "Also SIFT + PnP, with a view of the map at the prior");
  command->add_option("--out", o->out, "File for a JSON line per frame and method")->check(not_empty)->type_name("FILE");
  command->add_option("--export", e.export_to, "Write views of the map at the priors and frames, a manifest of `iclk batch`")
      ->check(not_empty)
      ->type_name("DIR");
  command->footer(kLocateEvalFooter + exit_codes_help("0 done"));
  command->callback([o, &exit] { run(*o, exit); });
}

}  // namespace iclk
