#pragma once
#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include <nlohmann/json.hpp>

#include "files.h"

namespace iclk::test {

using Json = nlohmann::ordered_json;

/// The built command as a process that can be killed.
class Process {
 public:
  explicit Process(
      const std::vector<std::string>& arguments, const std::function<void()>& before = [] {}) {
    pid_ = fork();
    if (pid_ != 0) return;
    dup2(open(folder_.path("out").c_str(), O_WRONLY | O_CREAT, 0600), 1);
    dup2(open(folder_.path("err").c_str(), O_WRONLY | O_CREAT, 0600), 2);
    for (const int number : {SIGINT, SIGTERM})
      std::signal(number, SIG_DFL);        // a script's background job begins with them ignored
    setenv("ICLK_MODEL", "classical", 0);  // most tests are about other things; `before` may unset it
    before();
    std::vector<char*> argv = {const_cast<char*>("iclk")};
    for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
    argv.push_back(nullptr);
    execv(ICLK_COMMAND, argv.data());
    _exit(127);
  }
  ~Process() {
    if (!ended_) kill(pid_, SIGKILL), wait();
  }

  void signal(int number) const { kill(pid_, number); }
  bool ended() {
    if (!ended_ && waitpid(pid_, &status_, WNOHANG) == pid_) ended_ = true;
    return ended_;
  }
  /// The exit code, or minus the signal that ended it.
  int wait() {
    if (!ended_) waitpid(pid_, &status_, 0);
    ended_ = true;
    return WIFEXITED(status_) ? WEXITSTATUS(status_) : -WTERMSIG(status_);
  }
  std::string out() const { return bytes_of(folder_.path("out")); }
  std::string err() const { return bytes_of(folder_.path("err")); }

 private:
  Folder folder_;
  pid_t pid_ = -1;
  int status_ = 0;
  bool ended_ = false;
};

/// False if `condition` does not come true within a minute.
inline bool wait_until(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

inline int count_lines(const std::string& path) {
  const std::string bytes = bytes_of(path);
  return static_cast<int>(std::count(bytes.begin(), bytes.end(), '\n'));
}

/// Results by id, without what differs from run to run. Fails the test for a line that is not whole, or an id that comes twice.
inline std::map<std::string, Json> results_of(const std::string& path) {
  const std::string bytes = bytes_of(path);
  EXPECT_TRUE(bytes.ends_with('\n')) << path << " ends in a half line";
  std::map<std::string, Json> results;
  size_t begin = bytes.find('\n') + 1;  // after the header
  EXPECT_TRUE(bytes.starts_with("{\"iclk_batch\":2,")) << path;
  for (size_t end; (end = bytes.find('\n', begin)) != std::string::npos; begin = end + 1) {
    Json line = Json::parse(bytes.substr(begin, end - begin), nullptr, false);
    if (!line.is_object()) {
      ADD_FAILURE() << path << ": not JSON: " << bytes.substr(begin, std::min<size_t>(end - begin, 200));
      continue;
    }
    line.erase("timing_ms");
    if (line.contains("stages"))
      for (Json& stage : line["stages"]) stage.erase("ms");
    const std::string id = line["id"];
    EXPECT_TRUE(results.emplace(id, std::move(line)).second) << "id " << id << " comes twice in " << path;
  }
  return results;
}

}  // namespace iclk::test
