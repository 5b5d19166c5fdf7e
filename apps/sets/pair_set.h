#pragma once
#include <cstdint>
#include <map>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>

#include "apps/eval/pose_errors.h"
#include "apps/render/pairs.h"

namespace iclk {

/// A folder of rendered pairs, made so that any moment is a good one to be killed in:
///
///   set.json              what the pairs depend on; written first
///   pairs.jsonl           a line a pair, as `iclk batch` takes it (batch_manifest.h), with truth and meta
///   images/000007_0.png   camera 0; 000007_1.png camera 1; 8-bit RGB
///   depth/000007.tiff     of camera 0, 32-bit float metres along the optical axis; 000007_1.tiff of camera 1, if asked for
///   features/000007.csv   u,v,depth of camera 0
///
/// A line is appended when the files of its pair are on the disk; files are whole or not there. A set goes on where it was
/// stopped, and may be made longer; one that was begun with other options is refused.
class PairSet {
 public:
  /// `options`: all that the pairs depend on. `about`: what is written beside it for people, and not compared.
  /// Throws Error(io) if the folder cannot be written or another process writes it; Error(invalid_argument) if it holds
  /// something else, a damaged manifest, or pairs of other options (which one, then and now).
  PairSet(const std::string& folder, const nlohmann::ordered_json& options, const nlohmann::ordered_json& about);
  ~PairSet();
  PairSet(const PairSet&) = delete;
  PairSet& operator=(const PairSet&) = delete;

  bool has(uint64_t index) const { return lines_.contains(index); }
  size_t size() const { return lines_.size(); }
  /// The manifest's lines by index.
  const std::map<uint64_t, nlohmann::ordered_json>& lines() const { return lines_; }
  std::string manifest() const { return folder_ + "/pairs.jsonl"; }
  /// Bytes that the file system has left for us.
  uint64_t free_bytes() const;

  /// Writes the files of a pair, then its line. `target_depth`: camera 1's depth too, as meta.target_depth, for methods that
  /// want depth of both images. Throws Error(io): disk full.
  void add(uint64_t index, const RenderedPair& pair, const Camera& camera, const Features& features, bool target_depth);

 private:
  void open_manifest();
  void read_lines();

  std::string folder_;
  int file_ = -1;
  std::map<uint64_t, nlohmann::ordered_json> lines_;
};

/// A pose as manifests have it: 4x4 nested lists.
nlohmann::ordered_json pose_json(const SE3& T);

/// How far a pair's start, no motion, is from its truth.
PoseError start_error(const Camera& camera, const Features& features, const SE3& T_10);

/// The most that a pair can take on the disk, bytes: pixels that do not compress at all.
uint64_t largest_pair(const Camera& camera, int features, bool target_depth);

/// A view's colours as PNG, and depth as TIFF of 32-bit floats.
std::string encode_view(const View& view);
std::string encode_depth(const View& view);

}  // namespace iclk
