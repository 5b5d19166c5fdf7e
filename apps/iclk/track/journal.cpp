#include "apps/iclk/track/journal.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/options.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/track/output.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

/// s in the tracker, from state to state, and over what writing one takes.
constexpr double kLeastBetween = 0.5, kShareBetween = 20;
const char* const kLiveHeader = "# timestamp tx ty tz qx qy qz qw (camera to world)\n";

/// Opens a file to write behind its first `size` bytes.
std::ofstream open_at(const std::string& path, uint64_t size) {
  std::error_code error;
  if (size > 0) fs::resize_file(path, size, error);
  std::ofstream file(path, size > 0 ? std::ios::app | std::ios::binary : std::ios::trunc | std::ios::binary);
  if (error || !file) throw Error(ErrorCode::io, path + ": cannot be written: " + std::strerror(errno));
  return file;
}

}  // namespace

Journal::Journal(const std::string& folder, nlohmann::ordered_json options, bool fresh, Tracker& tracker)
    : options_(std::move(options)) {
  if (folder.empty()) return;
  const auto path = [&](const char* name) { return (fs::path(folder) / name).string(); };
  state_path_ = path("stopped.state");
  lines_path_ = path("frames.jsonl");
  live_path_ = path("live.txt");
  lock_.emplace(lines_path_, "another iclk track is writing it: give another --out");
  if (!fresh && fs::exists(state_path_)) restore(folder, tracker);
  last_saved_ = counts_.seconds;
  lines_ = open_at(lines_path_, lines_size_);
  live_ = open_at(live_path_, live_size_);
  if (live_size_ == 0) grow(live_, live_path_, kLiveHeader, live_size_);
  if (results_.empty()) fs::remove(state_path_);
}

void Journal::restore(const std::string& folder, Tracker& tracker) {
  const std::string bytes = read_file(state_path_);
  const size_t end = bytes.find('\n');
  try {
    const auto head =
        nlohmann::ordered_json::parse(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(std::min(end, bytes.size())));
    if (const std::string other = other_option(head.at("options"), options_); !other.empty())
      refuse(folder + " has a stopped run " + other + ": give the same to continue, another --out, or --fresh");
    lines_size_ = head.at("frames_jsonl");
    live_size_ = head.at("live_txt");
    counts_ = {head.at("seconds"), head.at("without_depth"), head.at("unreadable"), head.at("first_problem")};
    const std::string lines = read_file(lines_path_);
    if (lines.size() < lines_size_ || fs::file_size(live_path_) < live_size_)
      throw Error(ErrorCode::invalid_argument, "frames.jsonl or live.txt has become shorter");
    for (const std::string_view line : lines_of(std::string_view(lines).substr(0, lines_size_)))
      if (!line.empty()) results_.push_back(parse_frame_json(line));
    tracker.restore({reinterpret_cast<const uint8_t*>(bytes.data()) + end + 1, bytes.size() - end - 1});
  } catch (const nlohmann::json::exception&) {
    throw Error(ErrorCode::invalid_argument, state_path_ + " is damaged: start again with --fresh");
  } catch (const Error& error) {
    if (std::strstr(error.what(), "--fresh")) throw;
    throw Error(error.code(), state_path_ + ": " + error.what() + "; start again with --fresh");
  }
}

void Journal::grow(std::ofstream& file, const std::string& path, const std::string& text, uint64_t& size) {
  file << text << std::flush;
  if (!file) throw Error(ErrorCode::io, path + ": cannot be written: " + std::strerror(errno));
  size += text.size();
}

TrackResult Journal::add(const TrackResult& result, const TrackCounts& counts, const Tracker& tracker) {
  const std::string line = frame_json(result);
  if (!state_path_.empty()) {
    grow(lines_, lines_path_, line, lines_size_);
    if (result.status != TrackStatus::lost)
      grow(live_, live_path_, fmt::format("{:.6f} {}\n", result.time, tum_line(result.T_WC)), live_size_);
    counts_ = counts;
    if (counts.seconds - last_saved_ > std::max(kLeastBetween, kShareBetween * save_takes_)) save(tracker);
  }
  return parse_frame_json(line);
}

void Journal::save(const Tracker& tracker) {
  const internal::Stopwatch watch;
  const nlohmann::ordered_json head{{"options", options_},
                                    {"frames_jsonl", lines_size_},
                                    {"live_txt", live_size_},
                                    {"seconds", counts_.seconds},
                                    {"without_depth", counts_.without_depth},
                                    {"unreadable", counts_.unreadable},
                                    {"first_problem", counts_.first_problem}};
  const std::vector<uint8_t> state = tracker.state();
  std::string bytes = head.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";  // names of files in it
  bytes.append(reinterpret_cast<const char*>(state.data()), state.size());
  write_file(state_path_, bytes);
  last_saved_ = counts_.seconds;
  save_takes_ = watch.ms() / 1000;
}

void Journal::finish() {
  std::error_code ignored;
  if (!state_path_.empty()) fs::remove(state_path_, ignored);
}

}  // namespace iclk
