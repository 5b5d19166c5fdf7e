#include "apps/iclk/io/euroc.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <map>

#include <iclk/engine/error.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kSameMoment = 1'000'000;  // ns: cameras that one signal triggers, stamped by two clocks or roundings

/// Nanoseconds, and the path of the image.
std::map<uint64_t, std::string> load_images(const fs::path& camera) {
  const std::string path = (camera / "data.csv").string(), text = read_file(path);
  std::map<uint64_t, std::string> images;
  int number = 0;
  for (const std::string_view raw : lines_of(text)) {
    ++number;
    const std::string_view line = without_comment(raw);
    if (line.empty()) continue;
    const size_t comma = line.find(',');
    const std::string_view word = trim(line.substr(0, comma));
    const std::string_view name = comma == std::string_view::npos ? "" : trim(line.substr(comma + 1));
    uint64_t stamp = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), stamp);
    if (word.empty() || error != std::errc() || end != word.data() + word.size() || name.empty())
      throw Error(ErrorCode::invalid_argument,
                  path + ":" + std::to_string(number) + ": 'nanoseconds,filename' expected, not '" + printable(line) + "'");
    images[stamp] = (camera / "data" / std::string(name)).string();
  }
  if (images.empty()) throw Error(ErrorCode::invalid_argument, path + ": no line 'nanoseconds,filename'");
  return images;
}

/// The image whose time is nearest; nullptr where none is of the same moment.
const std::string* at_moment(const std::map<uint64_t, std::string>& images, uint64_t stamp) {
  const auto away = [&](const auto& it) { return it->first > stamp ? it->first - stamp : stamp - it->first; };
  auto nearest = images.lower_bound(stamp);
  if (nearest == images.end() || (nearest != images.begin() && away(std::prev(nearest)) < away(nearest))) --nearest;
  return away(nearest) <= kSameMoment ? &nearest->second : nullptr;
}

/// T_WB: "timestamp [ns], p x y z, q w x y z, ...".
std::vector<StampedPose> load_truth(const std::string& path) {
  std::vector<StampedPose> poses;
  const std::string text = read_file(path);
  int number = 0;
  for (const std::string_view raw : lines_of(text)) {
    ++number;
    const std::string_view line = without_comment(raw);
    if (line.empty()) continue;
    const std::string where = path + ":" + std::to_string(number);
    const std::vector<double> x = parse_numbers(line, where);
    if (x.size() < 8 || !std::isfinite(x[0]))
      throw Error(ErrorCode::invalid_argument, where + ": 'ns, px, py, pz, qw, qx, qy, qz' expected");
    const double tum[] = {x[1], x[2], x[3], x[5], x[6], x[7], x[4]};
    poses.push_back({1e-9 * x[0], pose_from_tum(tum, where)});
  }
  std::stable_sort(poses.begin(), poses.end(), [](const auto& a, const auto& b) { return a.stamp < b.stamp; });
  return poses;
}

}  // namespace

std::optional<std::string> euroc_root(const std::string& folder) {
  for (const fs::path& root : {fs::path(folder), fs::path(folder) / "mav0"})
    if (fs::exists(root / "cam0" / "data.csv")) return root.string();
  return {};
}

Sequence load_euroc_sequence(const std::string& root) {
  Sequence sequence;
  sequence.folder = root;
  sequence.rig = load_stereo(root);
  const auto left = load_images(fs::path(root) / "cam0"), right = load_images(fs::path(root) / "cam1");
  const fs::path truth_path = fs::path(root) / "state_groundtruth_estimate0" / "data.csv";
  std::vector<StampedPose> truth;
  if (fs::exists(truth_path)) truth = load_truth(truth_path.string());
  for (const auto& [stamp, image] : left) {
    const std::string* const other = at_moment(right, stamp);
    if (other == nullptr) continue;
    SequenceFrame frame{1e-9 * static_cast<double>(stamp), image, {}, {}, *other};
    SE3 T_WB;
    if (interpolate(truth, frame.stamp, kMaxTruthGap, T_WB)) frame.T_wc = T_WB * sequence.rig->T_bl;
    sequence.frames.push_back(std::move(frame));
  }
  if (sequence.frames.empty())
    throw Error(ErrorCode::invalid_argument, root + ": no images of cam0 and cam1 have the same time, within 1 ms");
  std::stable_sort(sequence.frames.begin(), sequence.frames.end(),
                   [](const auto& a, const auto& b) { return a.stamp < b.stamp; });
  return sequence;
}

}  // namespace iclk
