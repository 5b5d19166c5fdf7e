// `iclk track --peers` and `iclk depth --peers`.
#include "apps/eval/peers/odometry.h"
#include "apps/eval/peers/stereo.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/commands/program.h"

int main(int argc, char** argv) {
  return iclk::run_program({[](CLI::App& app, int& exit) { add_track(app, exit, iclk::odometry_table); },
                            [](CLI::App& app, int& exit) { add_depth(app, exit, iclk::depth_peers); }},
                           {argv + 1, argv + argc}, false, "iclk peers");
}
