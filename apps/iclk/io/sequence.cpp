#include "apps/iclk/io/sequence.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <initializer_list>
#include <map>

#include <iclk/engine/error.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/io/time_unit.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

struct StampedFile {
  double stamp;
  std::string path;
};

std::vector<StampedFile> load_list(const fs::path& folder, const char* name) {
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

/// Times become seconds. The unit they were in.
template <class Stamped>
double make_seconds(std::vector<Stamped>& list, double usual = 0) {
  std::vector<double> times;
  for (const Stamped& x : list) times.push_back(x.stamp);
  const double unit = time_unit(times, usual);
  for (Stamped& x : list) x.stamp *= unit;
  return unit;
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

/// Names as a person counts: frame2 before frame10.
bool natural_less(const std::string& a, const std::string& b) {
  const auto digit = [](char c) { return c >= '0' && c <= '9'; };
  size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (!digit(a[i]) || !digit(b[j])) {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i, ++j;
      continue;
    }
    const auto number = [&](const std::string& s, size_t& at) {
      while (at < s.size() && s[at] == '0') ++at;
      const size_t from = at;
      while (at < s.size() && digit(s[at])) ++at;
      return s.substr(from, at - from);
    };
    const std::string n = number(a, i), m = number(b, j);
    if (n != m) return n.size() != m.size() ? n.size() < m.size() : n < m;
  }
  return a.size() - i != b.size() - j ? a.size() - i < b.size() - j : a < b;
}

std::optional<fs::path> first_folder(const fs::path& root, std::initializer_list<const char*> names) {
  for (const char* name : names)
    if (fs::is_directory(root / name)) return root / name;
  return {};
}

/// 20240305123045 or 20240305123045123: a date and a time of day.
bool is_date(const std::string& digits) {
  if ((digits.size() != 14 && digits.size() != 17) || (!digits.starts_with("19") && !digits.starts_with("20"))) return false;
  const auto at = [&](size_t i) { return 10 * (digits[i] - '0') + digits[i + 1] - '0'; };
  return at(4) >= 1 && at(4) <= 12 && at(6) >= 1 && at(6) <= 31 && at(8) < 24 && at(10) < 60 && at(12) < 60;
}

/// The time that a name is, in its own unit.
std::optional<double> time_of(const std::string& stem) {
  constexpr size_t kLongest = 16;  // digits; shorter ones are times from so much on
  constexpr double kLeast = 1e9;
  const bool digits = !stem.empty() && stem.find_first_not_of("0123456789") == std::string::npos;
  const bool seconds = stem.find_first_not_of("0123456789.") == std::string::npos && stem.find('.') != std::string::npos;
  const auto value = to_number(stem);
  if ((!seconds && !digits) || !value || !std::isfinite(*value) || is_date(stem)) return {};
  return seconds || stem.size() >= kLongest || *value >= kLeast ? value : std::nullopt;
}

/// Names of 19 digits are nanoseconds, with zeros before them too.
double unit_of_names(const std::vector<fs::path>& files) {
  constexpr size_t kNanoseconds = 19;
  std::vector<double> times;
  for (const fs::path& file : files) times.push_back(time_of(file.stem().string()).value_or(0));
  std::sort(times.begin(), times.end());
  return files[0].stem().string().size() == kNanoseconds ? 1e-9 : time_unit(times);
}

/// Image and depth in two folders, by their names. The unit of times.
double list_folders(const fs::path& root, const SequenceOptions& options, Sequence& sequence) {
  const auto images = first_folder(root, {"rgb", "color", "images", "image"}), depths = first_folder(root, {"depth", "depths"});
  if (!images || (!depths && options.need_depth))
    throw Error(ErrorCode::io,
                "no " + (root / "rgb.txt").string() + ", nor folders rgb (or color, images, image) and depth (or depths)");
  std::map<std::string, std::string> depth_of;
  if (depths)
    for (const fs::path& file : list_files(*depths)) depth_of[file.stem().string()] = file.string();
  const std::vector<fs::path> files = list_files(*images);
  if (files.empty()) throw Error(ErrorCode::invalid_argument, images->string() + " has no image");
  bool timed = true, any_depth = false;
  for (const fs::path& file : files) timed = timed && time_of(file.stem().string());
  const double unit = timed ? unit_of_names(files) : 0;
  for (size_t i = 0; i < files.size(); ++i) {
    const std::string stem = files[i].stem().string();
    const auto depth = depth_of.find(stem);
    any_depth = any_depth || depth != depth_of.end();
    sequence.frames.push_back({timed ? unit * *time_of(stem) : static_cast<double>(i) / options.rate,
                               files[i].string(),
                               depth == depth_of.end() ? "" : depth->second,
                               {},
                               {}});
  }
  if (!any_depth && options.need_depth)
    throw Error(ErrorCode::invalid_argument, "no file of " + depths->string() + " has the name of an image in " +
                                                 images->string() + ", such as " + files[0].stem().string());
  std::stable_sort(sequence.frames.begin(), sequence.frames.end(),
                   [](const auto& a, const auto& b) { return a.stamp < b.stamp; });
  return unit;
}

double list_tum(const fs::path& root, const SequenceOptions& options, Sequence& sequence) {
  std::vector<StampedFile> images = load_list(root, "rgb.txt");
  const double unit = make_seconds(images);
  std::vector<StampedFile> depths;
  if (options.need_depth || fs::exists(root / "depth.txt")) depths = load_list(root, "depth.txt");
  make_seconds(depths, unit);
  const std::vector<int> match = associate(images, depths, options.max_difference);
  for (size_t i = 0; i < images.size(); ++i)
    sequence.frames.push_back(
        {images[i].stamp, images[i].path, match[i] < 0 ? "" : depths[static_cast<size_t>(match[i])].path, {}, {}});
  return unit;
}

}  // namespace

std::vector<fs::path> list_files(const fs::path& folder) {
  std::error_code error;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.is_regular_file() && entry.path().filename().string().front() != '.') files.push_back(entry.path());
  if (error) throw Error(ErrorCode::io, folder.string() + ": cannot be read as a folder (" + error.message() + ")");
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return natural_less(a.stem().string(), b.stem().string()); });
  return files;
}

Sequence load_sequence(const std::string& folder, const SequenceOptions& options) {
  const fs::path root(folder);
  Sequence sequence;
  sequence.folder = folder;
  const bool tum = fs::exists(root / "rgb.txt") || !fs::is_directory(root);
  const double unit = tum ? list_tum(root, options, sequence) : list_folders(root, options, sequence);
  sequence.unit = unit;
  std::vector<StampedPose> truth;
  if (fs::exists(root / "groundtruth.txt")) truth = load_trajectory((root / "groundtruth.txt").string());
  make_seconds(truth, unit);
  if (fs::exists(root / "camera.txt")) sequence.camera = load_camera((root / "camera.txt").string());
  for (SequenceFrame& frame : sequence.frames) {
    SE3 T_wc;
    if (interpolate(truth, frame.stamp, kMaxTruthGap, T_wc)) frame.T_wc = T_wc;
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
