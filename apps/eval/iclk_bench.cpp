// `iclk bench`.
#include "apps/eval/commands.h"
#include "apps/iclk/commands/program.h"

int main(int argc, char** argv) {
  std::vector<std::string> arguments(argv, argv + argc);
  arguments.front() = "bench";
  return iclk::run_program({iclk::add_bench}, arguments);
}
