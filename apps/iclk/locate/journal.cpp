#include "apps/iclk/locate/journal.h"

#include <cerrno>
#include <cstring>
#include <filesystem>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/options.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/locate/frames.h"
#include "apps/json/json.h"

namespace iclk {

namespace fs = std::filesystem;

LocatedJournal::LocatedJournal(const std::string& folder, const nlohmann::ordered_json& options, bool fresh)
    : path_((fs::path(folder) / "located.jsonl").string()),
      lock_(path_, "another iclk locate is writing it: give another --out") {
  const std::string options_path = (fs::path(folder) / "options.json").string();
  if (!fresh && fs::file_size(path_) > 0) restore(options_path, options);
  fs::resize_file(path_, size_);
  if (size_ == 0) write_file(options_path, options.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n");
  file_.open(path_, std::ios::app | std::ios::binary);
  if (!file_) throw Error(ErrorCode::io, path_ + ": cannot be written: " + std::strerror(errno));
}

void LocatedJournal::restore(const std::string& options_path, const nlohmann::ordered_json& options) {
  const std::string remedy = "; give another --out, or --fresh to begin anew";
  const auto begun = fs::exists(options_path) ? parse_json(read_file(options_path)) : nlohmann::ordered_json();
  if (!begun.is_object()) refuse(path_ + " has results, but " + options_path + " is missing or damaged" + remedy);
  if (const std::string other = other_option(begun, options); !other.empty())
    refuse(path_ + " was " + other + ": give the same to continue" + remedy);
  const std::string text = read_file(path_);
  for (size_t end = text.find('\n'); end != std::string::npos; end = text.find('\n', size_)) {
    const auto frame = parse_located_json(std::string_view(text).substr(size_, end - size_));
    if (!frame) refuse(path_ + ":" + std::to_string(frames_.size() + 1) + " is damaged" + remedy);
    frames_.push_back(*frame);
    names_.insert(frame_name(frame->image));
    size_ = end + 1;
  }
}

bool LocatedJournal::has(const std::string& image) const { return names_.contains(frame_name(image)); }

void LocatedJournal::add(const LocatedFrame& frame, const MapSystem& map) {
  const std::string line = located_json(frame, map);
  file_ << line << std::flush;
  if (!file_) {
    const std::string why = std::strerror(errno);
    std::error_code ignored;
    fs::resize_file(path_, size_, ignored);
    throw Error(ErrorCode::io, path_ + ": cannot be written: " + why + "; the same command continues from here");
  }
  size_ += line.size();
  frames_.push_back(parse_located_json(line).value());
  names_.insert(frame_name(frame.image));
}

void LocatedJournal::clear() {
  frames_.clear(), names_.clear();
  size_ = 0;
  fs::resize_file(path_, 0);
}

void LocatedJournal::replace(const std::vector<LocatedFrame>& frames, const MapSystem& map) {
  std::string lines;
  for (const LocatedFrame& frame : frames) lines += located_json(frame, map);
  write_file(path_, lines);
}

}  // namespace iclk
