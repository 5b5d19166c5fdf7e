#pragma once
#include <map>
#include <string>
#include <vector>

namespace iclk {

// As of git: the program iclk-NAME, beside this one or in a folder of PATH, is the subcommand NAME. Names are of a-z and -.

/// Those that are there, by name, with what they are for.
std::map<std::string, std::string> other_programs();

/// The file of iclk-NAME; empty where there is none, and for every other name.
std::string find_program(const std::string& name);

/// This process becomes the program. Throws Error(io) if it cannot.
[[noreturn]] void become_program(const std::string& path, const std::vector<std::string>& arguments);

/// What was looked for, where, and how to come by it, of a name that find_program() does not find.
std::string missing_program(const std::string& name);

}  // namespace iclk
