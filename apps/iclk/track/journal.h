#pragma once
#include <cstdint>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/track/tracker.h>

#include "apps/iclk/common/file_lock.h"
#include "apps/iclk/track/run.h"

namespace iclk {

/// What a run has written so far: live.txt and frames.jsonl, which grow with every frame, and now and then all that its tracker
/// knows, from which a killed run goes on. Locked against a second run. With an empty folder nothing is written.
class Journal {
 public:
  /// `options`: the results depend on these, by name. `fresh`: begins anew, whatever is there. Otherwise a stopped run is
  /// continued: `tracker` is restored, and lines written after its state are cut off.
  /// Throws Error(io) if a file cannot be read or written, or another run writes there; Error(invalid_argument) if an option
  /// differs, which it names, or the state is broken.
  Journal(const std::string& folder, nlohmann::ordered_json options, bool fresh, Tracker& tracker);

  /// Of a run that goes on: what it had. Empty at a beginning.
  const std::vector<TrackResult>& results() const { return results_; }
  const TrackCounts& counts() const { return counts_; }

  /// The result as it comes back from the file. `counts`: of the whole run, with this frame.
  TrackResult add(const TrackResult& result, const TrackCounts& counts, const Tracker& tracker);
  /// The run is done: the next one begins anew.
  void finish();

 private:
  void grow(std::ofstream& file, const std::string& path, const std::string& text, uint64_t& size);
  void save(const Tracker& tracker);

  void restore(const std::string& folder, Tracker& tracker);

  std::string state_path_, lines_path_, live_path_;
  nlohmann::ordered_json options_;
  std::optional<FileLock> lock_;
  std::ofstream lines_, live_;
  uint64_t lines_size_ = 0, live_size_ = 0;
  TrackCounts counts_;
  double last_saved_ = 0, save_takes_ = 0;
  std::vector<TrackResult> results_;
};

}  // namespace iclk
