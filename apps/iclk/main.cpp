#include "apps/iclk/commands/command.h"
#include "apps/iclk/commands/program.h"

int main(int argc, char** argv) {
  using namespace iclk;
  return run_program(
      {add_align, add_batch, add_demo, add_devices, add_locate, add_model, add_render, add_depth, add_stereo, add_track},
      {argv + 1, argv + argc}, true);
}
