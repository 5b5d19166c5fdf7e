#include "apps/iclk/sets/render_loop.h"

#include <future>

#include <spdlog/spdlog.h>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>

#include "apps/iclk/common/progress.h"
#include "apps/iclk/sets/set_folder.h"

namespace iclk {
namespace {

std::string megabytes(uint64_t bytes) { return std::to_string((bytes + 999999) / 1000000) + " MB"; }

}  // namespace

double render_each(const char* unit, const std::vector<uint64_t>& todo, uint64_t total,
                   const std::function<std::function<void()>(uint64_t)>& make) {
  const internal::Stopwatch watch;
  const auto seconds = [&] { return watch.ms() / 1000; };
  ProgressBar bar;
  ProgressState state{static_cast<int>(total), static_cast<int>(total - todo.size()), 0, 0, 0};
  state.unit = unit;
  std::future<void> writing;
  const auto finish = [&] {
    if (!writing.valid()) return;
    writing.get();
    ++state.done, state.seconds = seconds();
    bar.show(state);
  };
  for (const uint64_t index : todo) {
    auto write = make(index);
    finish();
    writing = std::async(std::launch::async, std::move(write));
  }
  finish();
  bar.clear();
  return seconds();
}

void check_disk(const std::string& folder, const std::string& what, uint64_t count, uint64_t room, const std::string& remedy) {
  const uint64_t needed = room * count, there = free_bytes(folder);
  spdlog::info("{} {} to render into {}: at most {} ({} each), {} are free", count, what, folder, megabytes(needed),
               megabytes(room), megabytes(there));
  if (needed > there)
    throw Error(ErrorCode::io, folder + ": " + std::to_string(count) + " " + what + " may take " + megabytes(needed) +
                                   ", the disk has " + megabytes(there) + " left; " + remedy);
}

}  // namespace iclk
