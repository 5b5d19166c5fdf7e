#pragma once
#include <chrono>
#include <functional>
#include <optional>
#include <string>
#include <unordered_set>

#include <nlohmann/json.hpp>

#include "apps/iclk/batch/inputs.h"
#include "apps/json/manifest.h"

namespace iclk {

/// The results of `iclk batch`, made so that any moment is a good one to be killed in.
///
/// The first line is a header: {"iclk_batch": 2, "version": ..., "manifest": absolute path, "options": {...}}. Then a line a
/// pair, in the order in which they were finished: {"id", "line", "key", "status", "inputs" (batch_inputs.h), "errors" (with a
/// truth), "reason", ... the JSON contract of report.h}. Each is written by one write() at the end of the file. What a kill
/// leaves half written is cut off by whoever continues.
///
/// Results that would be other ones today are refused: the file continues only if the header's version and options are the
/// same, each id in it is in the manifest, and neither the line of that id nor what it is read from has changed since. So lines
/// may be added to a manifest, moved (if they carry ids), and the whole folder may be moved or mounted elsewhere. What would
/// look alike and is not is the same text in another folder: where the header's manifest still exists and lies in another
/// folder, the file is refused too.
class ResultsJournal {
 public:
  enum class Retry { none, failed, changed };
  struct Options {
    nlohmann::ordered_json run;  ///< what the results depend on, for the header
    std::string version;
    /// failed: drop the lines whose status is "error", so that these pairs run again. changed: those that would be refused.
    Retry retry = Retry::none;
    /// What a line is read from, now. Empty: nobody asks.
    std::function<LineInputs(const ManifestLine&)> inputs;
  };
  /// Called with the head of every result that is there already: id, line, key, status, errors.
  using Seen = std::function<void(const nlohmann::ordered_json&)>;

  /// Opens or begins the file and locks it against a second writer. Nothing is changed before everything was checked.
  /// A path that is no regular file (a pipe, a terminal) is written to and never continued.
  /// Throws Error(io) if it cannot be read or written or another process writes it, Error(invalid_argument) for results of
  /// another manifest, other options, or a file that is no results file; each with the remedy.
  ResultsJournal(const std::string& path, const Manifest& manifest, const Options& options, const Seen& seen);
  ~ResultsJournal();
  ResultsJournal(const ResultsJournal&) = delete;
  ResultsJournal& operator=(const ResultsJournal&) = delete;

  bool has(const std::string& id) const { return done_.contains(id); }
  int dropped() const { return dropped_; }  ///< lines that Retry took out
  bool regular() const { return regular_; }

  /// One line, one write(). The disk is synchronised every second. Throws Error(io): the file then ends with the last whole
  /// line.
  void append(const nlohmann::ordered_json& line);
  /// Throws Error(io): what was appended since the last sync may be lost.
  void sync();

 private:
  void open_file();
  std::optional<std::string> read_lines(const Manifest& manifest, const Options& options, const Seen& seen);
  std::string header_text(const Manifest& manifest, const Options& options) const;
  std::string check_header(std::string_view line, const Manifest& manifest, const Options& options) const;
  bool check_line(const std::string& where, const nlohmann::ordered_json& head, const Manifest& manifest,
                  const ManifestLine& source, const Options& options) const;
  nlohmann::ordered_json read_head(std::string_view line, int number) const;
  void write_text(const std::string& text);

  std::string path_;
  int file_ = -1;
  bool regular_ = false;
  size_t size_ = 0;  // of the whole lines
  int dropped_ = 0;
  std::unordered_set<std::string> done_;
  std::chrono::steady_clock::time_point synced_;
};

/// The opening of a result line, in the order that the journal reads fastest; the rest is appended to it.
nlohmann::ordered_json result_head(const ManifestLine& line, const std::string& status,
                                   const nlohmann::ordered_json& inputs = nullptr);

}  // namespace iclk
