#include "apps/iclk/commands/other_programs.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <sstream>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

namespace fs = std::filesystem;
constexpr std::string_view kPrefix = "iclk-";

/// Of apps/eval.
const std::map<std::string, std::string> kOfIclk = {
    {"bench", "Measure the time per pair, on synthetic images"},
    {"eval", "Measure errors on pairs with true poses: every stage, other methods, changed images"},
    {"peers", "Run `track` and `depth` with --peers, beside other methods"},
};

bool is_name(std::string_view name) {
  const auto allowed = [](char c) { return (c >= 'a' && c <= 'z') || c == '-'; };
  return !name.empty() && name.front() != '-' && std::all_of(name.begin(), name.end(), allowed);
}

bool is_program(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error) && ::access(path.c_str(), X_OK) == 0;
}

fs::path own_folder() {
  std::error_code error;
  return fs::read_symlink("/proc/self/exe", error).parent_path();
}

std::vector<fs::path> folders() {
  std::vector<fs::path> folders = {own_folder()};
  const char* path = std::getenv("PATH");
  std::istringstream list(path ? path : "");
  for (std::string folder; std::getline(list, folder, ':');) folders.emplace_back(folder);
  std::erase_if(folders, [](const fs::path& folder) { return !folder.is_absolute(); });
  return folders;
}

}  // namespace

std::map<std::string, std::string> other_programs() {
  std::map<std::string, std::string> programs;
  for (const fs::path& folder : folders()) {
    std::error_code error;
    for (fs::directory_iterator file(folder, error), end; !error && file != end; file.increment(error)) {
      const std::string program = file->path().filename().string();
      if (!program.starts_with(kPrefix) || !is_name(program.substr(kPrefix.size())) || !is_program(file->path())) continue;
      const std::string name = program.substr(kPrefix.size());
      const auto own = kOfIclk.find(name);
      programs.emplace(name, own != kOfIclk.end() ? own->second : file->path().string());
    }
  }
  return programs;
}

std::string find_program(const std::string& name) {
  if (!is_name(name)) return "";
  for (const fs::path& folder : folders())
    if (const fs::path file = folder / (std::string(kPrefix) + name); is_program(file)) return file.string();
  return "";
}

void become_program(const std::string& path, const std::vector<std::string>& arguments) {
  std::vector<char*> words = {const_cast<char*>(path.c_str())};
  for (const std::string& argument : arguments) words.push_back(const_cast<char*>(argument.c_str()));
  words.push_back(nullptr);
  std::signal(SIGPIPE, SIG_DFL);
  ::execv(path.c_str(), words.data());
  throw Error(ErrorCode::io, path + ": cannot be run: " + std::strerror(errno));
}

std::string missing_program(const std::string& name) {
  const std::string subcommand = "subcommand '" + printable(name) + "'";
  if (!is_name(name)) return subcommand;
  const std::string program = std::string(kPrefix) + name;
  const std::string sought =
      subcommand + ": no program " + program + " in " + own_folder().string() + " or in a folder of PATH";
  if (!kOfIclk.contains(name)) return sought;
  return sought + "\nTo build it from iclk's sources: scripts/build default " + program +
         "\nIt needs OpenCV with features2d, video and rgbd (Debian: libopencv-dev).";
}

}  // namespace iclk
