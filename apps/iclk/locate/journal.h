#pragma once
#include <fstream>
#include <string>
#include <unordered_set>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/render/geotiff.h>

#include "apps/iclk/common/file_lock.h"
#include "apps/iclk/locate/output.h"

namespace iclk {

/// located.jsonl, which grows by a line per frame, so that a run that was stopped goes on. Locked against a second run.
/// options.json beside it has what the lines depend on.
class LocatedJournal {
 public:
  /// `options`: by the names of the command line. `fresh`: begins anew, whatever is there. A line that was half written is cut
  /// off. Throws Error(io) if a file cannot be read or written, or another run writes there; Error(invalid_argument) if an
  /// option differs, which it names, or a line is broken; each with the remedy.
  LocatedJournal(const std::string& folder, const nlohmann::ordered_json& options, bool fresh);

  /// All lines, as they come back from the file.
  const std::vector<LocatedFrame>& frames() const { return frames_; }
  bool has(const std::string& image) const;
  void add(const LocatedFrame& frame, const MapSystem& map);
  /// Takes all lines out.
  void clear();
  /// Writes these lines instead, whole or not at all. Nothing can be added afterwards.
  void replace(const std::vector<LocatedFrame>& frames, const MapSystem& map);

 private:
  void restore(const std::string& options_path, const nlohmann::ordered_json& options);

  std::string path_;
  FileLock lock_;
  uint64_t size_ = 0;  // of the whole lines
  std::ofstream file_;
  std::vector<LocatedFrame> frames_;
  std::unordered_set<std::string> names_;
};

}  // namespace iclk
