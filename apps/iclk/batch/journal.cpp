#include "apps/iclk/batch/journal.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <unordered_map>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/options.h"
#include "apps/iclk/common/refuse.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr std::string_view kMagic = "{\"iclk_batch\":";
constexpr int kFormat = 2;  // 1 did not say what the results were made of

[[noreturn]] void io_error(const std::string& path, const std::string& why) {
  throw Error(ErrorCode::io, "cannot write " + path + ": " + why);
}

std::string in_brackets(const std::string& why) { return why.empty() ? "" : " (" + why + ")"; }

std::string line_text(const Json& json) { return json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n"; }

}  // namespace

Json result_head(const ManifestLine& line, const std::string& status, const Json& inputs) {
  Json head = {{"id", line.id}, {"line", line.number}, {"key", line.key}, {"status", status}};
  if (!inputs.is_null()) head["inputs"] = inputs;
  return head;
}

ResultsJournal::ResultsJournal(const std::string& path, const Manifest& manifest, const Options& options, const Seen& seen)
    : path_(path) {
  try {
    open_file();
    std::optional<std::string> kept;
    if (regular_) kept = read_lines(manifest, options, seen);
    if (kept) {
      // Whole or not at all; the lock goes with the old file, so the new one is locked before anything is appended.
      write_file(path_, *kept);
      ::close(file_);
      open_file();
      size_ = kept->size();
    }
    if (regular_ && ::ftruncate(file_, static_cast<off_t>(size_)) != 0) io_error(path_, std::strerror(errno));
    if (size_ == 0) write_text(header_text(manifest, options));
    sync();
  } catch (...) {
    if (file_ >= 0) ::close(file_);
    throw;
  }
}

ResultsJournal::~ResultsJournal() { ::close(file_); }

void ResultsJournal::open_file() {
  struct stat info = {};
  const bool exists = ::stat(path_.c_str(), &info) == 0;
  regular_ = !exists || S_ISREG(info.st_mode);
  const int mode = regular_ ? O_RDWR | O_CREAT | O_APPEND : O_WRONLY | O_APPEND;
  file_ = ::open(path_.c_str(), mode | O_CLOEXEC, 0644);
  if (file_ < 0) io_error(path_, std::strerror(errno));
  if (regular_ && ::flock(file_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK)
    io_error(path_, "another iclk batch is writing it; give each shard its own file");
}

std::string ResultsJournal::header_text(const Manifest& manifest, const Options& options) const {
  std::error_code ignored;
  const fs::path absolute = fs::weakly_canonical(manifest.path, ignored);
  return line_text(
      {{"iclk_batch", kFormat}, {"version", options.version}, {"manifest", absolute.string()}, {"options", options.run}});
}

/// What makes every line of the file another one than it would be today, in words; empty if nothing does.
std::string ResultsJournal::check_header(std::string_view line, const Manifest& manifest, const Options& options) const {
  std::string why;
  const Json header = parse_json(line, &why);
  const auto text = [&](const char* key) {
    return header.contains(key) && header[key].is_string() ? header[key].get<std::string>() : std::string();
  };
  if (!header.is_object())
    refuse(path_ + ":1, the header, is damaged" + in_brackets(why) + ": nothing was written; give another --out");
  if (header["iclk_batch"] != kFormat)
    refuse(path_ + " was written by " + (text("version").empty() ? "another version of iclk" : text("version")) +
           " in format " + header["iclk_batch"].dump() + ", but this iclk continues format " + std::to_string(kFormat) +
           " only: nothing was written; give another --out");
  std::error_code ignored;
  const fs::path begun(text("manifest"));
  const fs::path now = fs::weakly_canonical(manifest.path, ignored);
  if (fs::exists(begun, ignored) && !fs::equivalent(begun.parent_path(), now.parent_path(), ignored))
    refuse(path_ + " has results of another manifest, " + begun.string() + " (this one is " + now.string() +
           "); give another --out");
  if (text("version") != options.version)
    return "was begun by " + text("version") + ", but this is " + options.version +
           ": a file must not mix results of two versions";
  const std::string other = other_option(header.value("options", Json::object()), options.run);
  return other.empty() ? "" : "was " + other + ": give the same to continue";
}

Json ResultsJournal::read_head(std::string_view line, int number) const {
  // A quote inside a JSON string is escaped, so this piece is always a key; what follows it may be long and is not needed.
  const size_t rest = line.find(",\"reason\":");
  std::string why;
  Json head = line.ends_with('}') && rest != std::string_view::npos ? parse_json(std::string(line.substr(0, rest)) + "}", &why)
                                                                    : parse_json(line, &why);
  const auto is_text = [&](const char* key) { return head.contains(key) && head[key].is_string(); };
  if (head.is_object() && !(is_text("id") && is_text("key") && is_text("status"))) head = parse_json(line, &why);
  if (!head.is_object() || !is_text("id") || !is_text("key") || !is_text("status"))
    refuse(path_ + ":" + std::to_string(number) + " is not a result of iclk batch" +
           in_brackets(why.empty() ? "damaged?" : why) + ": nothing was written; remove that line or give another --out");
  return head;
}

/// Sets size_ and done_. Returns what the file should hold instead, or nothing if it may stay as it is.
std::optional<std::string> ResultsJournal::read_lines(const Manifest& manifest, const Options& options, const Seen& seen) {
  std::ifstream in(path_, std::ios::binary);
  if (!in) throw Error(ErrorCode::io, "cannot read " + path_ + ": " + std::strerror(errno));
  std::unordered_map<std::string_view, const ManifestLine*> known;
  for (const ManifestLine& line : manifest.lines) known.emplace(line.id, &line);
  std::unordered_map<std::string, int> first;
  std::string kept;
  bool all_changed = false;
  int number = 0;
  size_t end = 0;
  for (std::string line; std::getline(in, line);) {
    const bool whole = !in.eof();
    if (++number == 1 && line.compare(0, kMagic.size(), kMagic.substr(0, whole ? kMagic.size() : line.size())) != 0)
      refuse(path_ + " exists and is not a results file of iclk batch: nothing was written; give another --out");
    if (!whole) break;  // half written when a run was killed: cut off
    end += line.size() + 1;
    if (number == 1) {
      const std::string change = check_header(line, manifest, options);
      all_changed = !change.empty();
      if (all_changed && options.retry != Retry::changed)
        refuse(path_ + " " + change + "; --retry changed runs all its pairs again; or give another --out");
      if (all_changed) line = trim(header_text(manifest, options));
    } else {
      const Json head = read_head(line, number);
      const std::string id = head["id"];
      const std::string where = path_ + ":" + std::to_string(number);
      const auto [other, is_new] = first.emplace(id, number);
      if (!is_new)
        refuse(where + " and :" + std::to_string(other->second) + " both have the result of id '" + printable(id) +
               "'; remove one of them");
      const auto source = known.find(id);
      const bool failed = head["status"].get_ref<const std::string&>() == "error";
      if (failed && options.retry == Retry::failed) {
        ++dropped_;
        continue;
      }
      if (source == known.end())
        refuse(where + " has the result of id '" + printable(id) + "', which is not in " + manifest.path +
               ": results of another manifest? give another --out");
      if (all_changed || check_line(where, head, manifest, *source->second, options)) {
        ++dropped_;
        continue;
      }
      done_.insert(id);
      seen(head);
    }
    size_ = end;
    if (options.retry != Retry::none) kept.append(line).append("\n");
  }
  if (in.bad()) throw Error(ErrorCode::io, "cannot read " + path_ + ": " + std::strerror(errno));
  return dropped_ > 0 || all_changed ? std::optional(kept) : std::nullopt;
}

/// Whether the line is to be done again. Throws for one that has changed, unless that was asked for.
bool ResultsJournal::check_line(const std::string& where, const Json& head, const Manifest& manifest,
                                const ManifestLine& source, const Options& options) const {
  const bool failed = head["status"].get_ref<const std::string&>() == "error";
  const bool same_text = source.key == head["key"].get_ref<const std::string&>();
  std::string change;
  if (!same_text)
    change = place(manifest, source) + " has changed since, or is of another manifest";
  else if (options.inputs && head.contains("inputs"))
    change = changed_input(head["inputs"], options.inputs(source));
  if (change.empty() || options.retry == Retry::changed) return !change.empty();
  if (failed && same_text) return false;  // what was missing has come: an error claims nothing that could be wrong by now
  refuse(where + " has the result of id '" + printable(source.id) + "', but " + change +
         "; --retry changed runs all changed pairs again, " + (failed ? "--retry all failed pairs; " : "") +
         "or give another --out");
}

void ResultsJournal::append(const Json& line) {
  write_text(line_text(line));
  if (std::chrono::steady_clock::now() - synced_ > std::chrono::seconds(1)) sync();
}

void ResultsJournal::write_text(const std::string& text) {
  ssize_t written = 0;
  do {
    written = ::write(file_, text.data(), text.size());
  } while (written < 0 && errno == EINTR);
  size_t done = written > 0 ? static_cast<size_t>(written) : 0;
  int error = written < 0 ? errno : 0;
  // A pipe may take less at a time; a file does so only when the disk or the quota is full, which the second write() tells.
  while (error == 0 && done < text.size()) {
    written = ::write(file_, text.data() + done, text.size() - done);
    if (written > 0)
      done += static_cast<size_t>(written);
    else if (written < 0 && errno != EINTR)
      error = errno;
  }
  if (error != 0) {
    const bool whole = regular_ && ::ftruncate(file_, static_cast<off_t>(size_)) == 0;
    io_error(path_,
             std::strerror(error) +
                 std::string(whole ? "; it ends with the last whole line, and the same command continues from there" : ""));
  }
  size_ += text.size();
}

void ResultsJournal::sync() {
  synced_ = std::chrono::steady_clock::now();
  if (regular_ && ::fdatasync(file_) != 0) io_error(path_, std::strerror(errno));
}

}  // namespace iclk
