#include "apps/io/sequence.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <iclk/engine/error.h>

#include "apps/io/pose_text.h"
#include "apps/io/text.h"

namespace iclk {
namespace {

constexpr double kMaxTruthGap = 0.25;  // s; motion capture drops out at times, and a straight line over more is no truth

struct StampedFile {
  double stamp;
  std::string path;
};

std::vector<StampedFile> load_list(const std::filesystem::path& folder, const char* name) {
  const std::string path = (folder / name).string();
  const std::string text = read_file(path);
  std::vector<StampedFile> files;
  int number = 0;
  for (const std::string_view raw : lines_of(text)) {
    ++number;
    const std::string_view line = without_comment(raw);
    if (line.empty()) continue;
    const size_t blank = line.find_first_of(" \t");
    const auto stamp = to_number(line.substr(0, blank));
    if (!stamp || !std::isfinite(*stamp) || blank == std::string_view::npos)
      throw Error(ErrorCode::invalid_argument,
                  path + ":" + std::to_string(number) + ": 'timestamp filename' expected, not '" + printable(line) + "'");
    files.push_back({*stamp, (folder / std::string(trim(line.substr(blank)))).string()});
  }
  if (files.empty()) throw Error(ErrorCode::invalid_argument, path + ": no line 'timestamp filename'");
  std::stable_sort(files.begin(), files.end(), [](const auto& a, const auto& b) { return a.stamp < b.stamp; });
  return files;
}

/// For each of `a` the index in `b`, or -1: nearest pairs first, each used once.
std::vector<int> associate(const std::vector<StampedFile>& a, const std::vector<StampedFile>& b, double max_difference) {
  struct Candidate {
    double difference;
    int a, b;
  };
  std::vector<Candidate> candidates;
  for (size_t i = 0, first = 0; i < a.size(); ++i) {
    while (first < b.size() && b[first].stamp < a[i].stamp - max_difference) ++first;
    for (size_t j = first; j < b.size() && b[j].stamp <= a[i].stamp + max_difference; ++j)
      candidates.push_back({std::abs(a[i].stamp - b[j].stamp), static_cast<int>(i), static_cast<int>(j)});
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& x, const auto& y) { return x.difference < y.difference; });
  std::vector<int> match(a.size(), -1);
  std::vector<bool> used(b.size(), false);
  for (const Candidate& c : candidates) {
    if (match[static_cast<size_t>(c.a)] >= 0 || used[static_cast<size_t>(c.b)]) continue;
    match[static_cast<size_t>(c.a)] = c.b;
    used[static_cast<size_t>(c.b)] = true;
  }
  return match;
}

}  // namespace

Sequence load_sequence(const std::string& folder, double max_difference) {
  const std::filesystem::path root(folder);
  Sequence sequence;
  sequence.folder = folder;
  const std::vector<StampedFile> images = load_list(root, "rgb.txt"), depths = load_list(root, "depth.txt");
  const std::vector<int> match = associate(images, depths, max_difference);
  std::vector<StampedPose> truth;
  if (std::filesystem::exists(root / "groundtruth.txt")) truth = load_trajectory((root / "groundtruth.txt").string());
  if (std::filesystem::exists(root / "camera.txt")) sequence.camera = load_camera((root / "camera.txt").string());
  for (size_t i = 0; i < images.size(); ++i) {
    SequenceFrame frame{images[i].stamp, images[i].path, match[i] < 0 ? "" : depths[static_cast<size_t>(match[i])].path, {}};
    SE3 T_wc;
    if (interpolate(truth, frame.stamp, kMaxTruthGap, T_wc)) frame.T_wc = T_wc;
    sequence.frames.push_back(std::move(frame));
  }
  return sequence;
}

std::vector<SequencePair> make_pairs(const Sequence& sequence, int stride) {
  if (stride < 1) throw Error(ErrorCode::invalid_argument, "stride " + std::to_string(stride) + " must be at least 1");
  std::vector<SequencePair> pairs;
  const int n = static_cast<int>(sequence.frames.size());
  for (int i = 0; i + stride < n; ++i) {
    const SequenceFrame &f0 = sequence.frames[static_cast<size_t>(i)], &f1 = sequence.frames[static_cast<size_t>(i + stride)];
    if (f0.depth.empty()) continue;
    SequencePair pair{i, i + stride, f0.image, f1.image, f0.depth, {}};
    if (f0.T_wc && f1.T_wc) pair.T_10 = f1.T_wc->inverse() * *f0.T_wc;
    pairs.push_back(std::move(pair));
  }
  return pairs;
}

}  // namespace iclk
