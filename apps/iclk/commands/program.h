#pragma once
#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace iclk {

/// Adds a subcommand whose callback leaves in `exit` what main() returns (command.h).
using AddCommand = void (*)(CLI::App& app, int& exit);

/// What main() returns for a program of these subcommands. `others`: a word that is none of them names a program of its own.
/// `name`: of the program, in its help.
int run_program(const std::vector<AddCommand>& commands, const std::vector<std::string>& arguments, bool others = false,
                const std::string& name = "iclk");

/// Thrown by a callback that leaves its work to iclk-NAME, with the same arguments.
struct NeedsProgram {
  std::string name;
};

}  // namespace iclk
