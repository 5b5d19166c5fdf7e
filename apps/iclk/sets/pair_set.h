#pragma once
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/render/pairs.h>
#include <iclk/session/pose_errors.h>

namespace iclk {

/// How a pair lies on the disk.
enum class SetLayout {
  /// As `iclk batch` takes it (apps/json/manifest.h), with truth and meta:
  ///   pairs.jsonl, images/000007_0.png of camera 0, images/000007_1.png of camera 1, 8-bit RGB; depth/000007.tiff of camera 0,
  ///   32-bit float metres along the optical axis, 000007_1.tiff of camera 1, if asked for; features/000007.csv, u,v,depth
  pairs,
  /// As `iclk stereo` takes it, the folder or its manifest: rig.jsonl, left/000007.png, right/000007.png, depth/000007.tiff
  rig,
};

/// A pair's files, by their names in the folder, and its line of the manifest.
struct SetEntry {
  std::vector<std::pair<std::string, std::string>> files;
  nlohmann::ordered_json line;
};

/// A folder of rendered pairs, made so that any moment is a good one to be killed in: set.json says what the pairs depend on
/// and is written first; a manifest has a line a pair, appended when the files of its pair are on the disk; files are whole or
/// not there. A set goes on where it was stopped, and may be made longer; one that was begun with other options is refused.
class PairSet {
 public:
  /// `options`: all that the pairs depend on. `about`: what is written beside it for people, and not compared.
  /// Throws Error(io) if the folder cannot be written or another process writes it; Error(invalid_argument) if it holds
  /// something else, a damaged manifest, or pairs of other options (which one, then and now).
  PairSet(const std::string& folder, SetLayout layout, const nlohmann::ordered_json& options,
          const nlohmann::ordered_json& about);
  ~PairSet();
  PairSet(const PairSet&) = delete;
  PairSet& operator=(const PairSet&) = delete;

  bool has(uint64_t index) const { return lines_.contains(index); }
  size_t size() const { return lines_.size(); }
  /// The manifest's lines by index.
  const std::map<uint64_t, nlohmann::ordered_json>& lines() const { return lines_; }
  std::string manifest() const { return folder_ + (layout_ == SetLayout::rig ? "/rig.jsonl" : "/pairs.jsonl"); }

  /// Writes the files of a pair, then its line, which has meta.index. Throws Error(io): disk full.
  void add(uint64_t index, const SetEntry& entry);
  /// Puts the lines into the order of their indices, in which one run would have written them. Throws Error(io).
  void sort();

 private:
  void open_manifest();
  void read_lines();

  std::string folder_;
  SetLayout layout_;
  std::vector<std::string> folders_;
  int file_ = -1;
  std::map<uint64_t, nlohmann::ordered_json> lines_;
  bool sorted_ = true;
};

/// In SetLayout::pairs. `lens`: of `camera`, both images are taken through it. `target_depth`: camera 1's depth too, as
/// meta.target_depth, for methods that want depth of both images.
SetEntry pair_entry(uint64_t index, const RenderedPair& pair, const Camera& camera, const Lens& lens, const Features& features,
                    bool target_depth);
/// In SetLayout::rig.
SetEntry rig_entry(uint64_t index, const RenderedPair& pair);

/// A pose as manifests have it: 4x4 nested lists.
nlohmann::ordered_json pose_json(const SE3& T);

/// How far a pair's start, no motion, is from its truth. Features of the undistorted image.
PoseError start_error(const Camera& camera, const Features& features, const SE3& T_10);

/// The most that a pair can take on the disk, bytes: pixels that do not compress at all. `depths`: 1 or 2.
uint64_t largest_pair(const Camera& camera, const Camera& second, int features, int depths);

/// A view's colours as PNG, and depth as TIFF of 32-bit floats.
std::string encode_view(const View& view);
std::string encode_depth(const View& view);

}  // namespace iclk
