#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/align/se3.h>
#include <iclk/session/io/text.h>

#include "apps/json/pair_files.h"

namespace iclk {

/// The pairs of `iclk batch`, one JSON object a line:
///
///   {"id": "a", "reference": "rgb/a.png", "target": "rgb/b.png", "depth": "depth/a.png", "depth_scale": 5000,
///    "camera": "517.3,516.5,318.6,255.3", "distortion": "radtan:0.26,-0.95,-0.005,0.003,1.16",
///    "initial_pose": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "truth": "0.01 0 0 0 0 0 1", "meta": {"sequence": 3}}
///
///   id             string or whole number, once in the file; default: the number of the line
///   reference, target               image files; required
///   depth, features                 depth image and / or feature file (CSV) of the reference; one of them is required
///   reference_mask, target_mask     images that hide pixels where they are 0
///   depth_scale, camera, distortion as the options of `iclk align`, which are their defaults; `camera` may be a list
///   initial_pose, truth             T_10: 4x4 (or 3x4) nested lists, a TUM line, or a file that holds one
///   meta                            anything; comes back in the result
///
/// Relative paths begin at the manifest's folder. Blank lines are skipped; null is as good as a missing key. Any other key is
/// an error, so that a misspelt "initial_pos" is not silently no initial pose.
struct ManifestLine {
  int number = 0;   ///< as an editor counts
  std::string id;   ///< "line 7" where line 7 is too broken to say
  std::string key;  ///< hash of the text: tells a changed line from the one that a result belongs to
  std::string text;
};

struct Manifest {
  std::string path, folder;
  std::vector<ManifestLine> lines;  ///< without the blank ones
};

/// Throws Error(io) for an unreadable file; Error(invalid_argument) if two lines have one id (it names both) or no line is
/// there. A broken line does not throw: parse_line does when its turn comes.
Manifest read_manifest(const std::string& path);

/// FNV-1a in hexadecimal. Not against malice: a person who wants to mix up results can.
std::string hash_of(std::string_view text);

/// What a line asks for.
struct PairRequest {
  PairFiles files;
  std::optional<std::string> camera, distortion;
  std::optional<double> depth_scale;
  std::optional<SE3> T_10;  ///< first guess
  std::optional<SE3> truth;
  std::string T_10_file, truth_file;  ///< that they were read from, if any
  nlohmann::ordered_json meta;        ///< null if there is none
};

/// Throws Error(invalid_argument) "<manifest>:<line>: ..." that names the key.
PairRequest parse_line(const Manifest& manifest, const ManifestLine& line);
/// The same of one line's text. `where` opens the messages, relative paths begin at `folder`.
PairRequest parse_request(const std::string& text, const std::string& where, const std::string& folder,
                          const FileReader& read = read_file);

/// "<manifest>:<line>", the opening of every message about a line.
std::string place(const Manifest& manifest, const ManifestLine& line);

/// `--shard k/n`: every n-th line that is not blank, beginning with the k-th.
struct Shard {
  int k = 0, n = 1;
};
/// Throws Error(invalid_argument) that names the text unless it is k/n with 0 <= k < n.
Shard parse_shard(const std::string& text);

}  // namespace iclk
