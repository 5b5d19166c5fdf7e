// `iclk eval`, `iclk eval locate` and `iclk eval flight`.
#include "apps/eval/commands.h"
#include "apps/iclk/commands/program.h"

int main(int argc, char** argv) {
  std::vector<std::string> arguments(argv, argv + argc);
  if (argc > 1 && arguments[1] == "flight") return iclk::run_program({iclk::add_flight_eval}, {argv + 1, argv + argc});
  if (argc > 1 && arguments[1] == "locate") return iclk::run_program({iclk::add_locate_eval}, {argv + 1, argv + argc});
  arguments.front() = "eval";
  return iclk::run_program({iclk::add_eval}, arguments);
}
