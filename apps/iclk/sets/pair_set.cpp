#include "apps/iclk/sets/pair_set.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <tuple>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/sets/set_folder.h"
#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

std::string id_of(uint64_t index) { return formatted("%06llu", static_cast<unsigned long long>(index)); }

}  // namespace

PairSet::PairSet(const std::string& folder, SetLayout layout, const Json& options, const Json& about)
    : folder_(folder),
      layout_(layout),
      folders_(layout == SetLayout::rig ? std::vector<std::string>{"left", "right", "depth"}
                                        : std::vector<std::string>{"images", "depth", "features"}) {
  open_set_folder(folder, "set.json", "iclk_pairs", options, about, folders_);
  try {
    open_manifest();
    std::vector<std::string> all = folders_;
    all.push_back(".");
    remove_half_written(folder, all);
    read_lines();
  } catch (...) {
    if (file_ >= 0) ::close(file_);
    throw;
  }
}

PairSet::~PairSet() { ::close(file_); }

void PairSet::open_manifest() {
  file_ = ::open(manifest().c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (file_ < 0) throw Error(ErrorCode::io, "cannot write " + manifest() + ": " + std::strerror(errno));
  if (::flock(file_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK)
    throw Error(ErrorCode::io, "cannot write " + manifest() + ": another iclk render is writing it");
}

void PairSet::read_lines() {
  const std::string text = read_file(manifest(), size_t{4} << 30);
  const size_t whole = text.rfind('\n') == std::string::npos ? 0 : text.rfind('\n') + 1;  // a kill may leave half a line
  int number = 0;
  for (const std::string_view line : lines_of(std::string_view(text).substr(0, whole))) {
    ++number;
    if (trim(line).empty()) continue;
    std::string why;
    Json json = parse_json(line, &why);
    if (!json.is_object() || !json.contains("meta") || !json["meta"].is_object() || !json["meta"].contains("index") ||
        !json["meta"]["index"].is_number_unsigned())
      refuse(manifest() + ":" + std::to_string(number) + " is not a line of this set" + (why.empty() ? "" : " (" + why + ")") +
             ": remove it, or give another --out");
    const uint64_t index = json["meta"]["index"].get<uint64_t>();
    sorted_ = sorted_ && (lines_.empty() || index > lines_.rbegin()->first);
    if (!lines_.emplace(index, std::move(json)).second)
      refuse(manifest() + ":" + std::to_string(number) + ": pair " + std::to_string(index) +
             " appears twice; remove one of the lines");
  }
  if (whole != text.size() && ::ftruncate(file_, static_cast<off_t>(whole)) != 0)
    throw Error(ErrorCode::io, "cannot write " + manifest() + ": " + std::strerror(errno));
}

void PairSet::add(uint64_t index, const SetEntry& entry) {
  for (const auto& [name, bytes] : entry.files) write_file(folder_ + "/" + name, bytes);
  const std::string text = entry.line.dump() + "\n";
  // One write, so that a kill leaves a line or a piece of one at the end of the file.
  // A full disk may take a piece too; the next write() says why.
  const off_t whole = ::lseek(file_, 0, SEEK_END);
  int error = 0;
  for (size_t done = 0; done < text.size() && error == 0;) {
    const ssize_t n = ::write(file_, text.data() + done, text.size() - done);
    if (n > 0)
      done += static_cast<size_t>(n);
    else if (n < 0 && errno != EINTR)
      error = errno;
  }
  // Where even that fails, read_lines() cuts.
  if (error != 0) std::ignore = ::ftruncate(file_, whole);
  if (error == 0 && ::fdatasync(file_) != 0) error = errno;
  if (error != 0) throw Error(ErrorCode::io, "cannot write " + manifest() + ": " + std::strerror(error));
  sorted_ = sorted_ && (lines_.empty() || index > lines_.rbegin()->first);
  lines_.emplace(index, entry.line);
}

void PairSet::sort() {
  if (sorted_) return;
  std::string text;
  for (const auto& [index, line] : lines_) text += line.dump() + "\n";
  write_file(manifest(), text);
  // The lock is on the file that this one replaced.
  ::close(file_);
  file_ = -1;
  open_manifest();
  sorted_ = true;
}

SetEntry pair_entry(uint64_t index, const RenderedPair& pair, const Camera& camera, const Lens& lens, const Features& features,
                    bool target_depth) {
  const std::string id = id_of(index);
  const std::string image0 = "images/" + id + "_0.png", image1 = "images/" + id + "_1.png", depth = "depth/" + id + ".tiff",
                    points = "features/" + id + ".csv";
  SetEntry entry{{{image0, encode_view(pair.view0)},
                  {image1, encode_view(pair.view1)},
                  {depth, encode_depth(pair.view0)},
                  {points, features_csv(features)}},
                 {}};
  Features seen = features;
  for (Eigen::Vector2d& uv : seen.uv) uv = pinhole_pixel(camera, lens, uv).value_or(uv);
  const PoseError start = start_error(camera, seen, pair.T_10);
  entry.line = {{"id", id},
                {"reference", image0},
                {"target", image1},
                {"depth", depth},
                {"features", points},
                {"camera", {camera.fx, camera.fy, camera.cx, camera.cy}},
                {"truth", pose_json(pair.T_10)},
                {"meta",
                 {{"index", index},
                  {"T_W0", pose_json(pair.T_W0)},
                  {"T_W1", pose_json(pair.T_W1)},
                  {"altitude", pair.altitude},
                  {"features", features.size()},
                  {"start", {{"e_pixel", start.e_pixel}, {"e_transl", start.e_transl}, {"e_rot", start.e_rot}}}}}};
  if (!lens.empty()) entry.line["distortion"] = distortion_text(lens.distortion());
  if (target_depth) {
    const std::string depth1 = "depth/" + id + "_1.tiff";
    entry.files.emplace_back(depth1, encode_depth(pair.view1));
    entry.line["meta"]["target_depth"] = depth1;
  }
  return entry;
}

SetEntry rig_entry(uint64_t index, const RenderedPair& pair) {
  const std::string id = id_of(index), left = "left/" + id + ".png", right = "right/" + id + ".png",
                    depth = "depth/" + id + ".tiff";
  return {{{left, encode_view(pair.view0)}, {right, encode_view(pair.view1)}, {depth, encode_depth(pair.view0)}},
          {{"left", left},
           {"right", right},
           {"depth", depth},
           {"meta", {{"index", index}, {"T_WL", pose_json(pair.T_W0)}, {"altitude", pair.altitude}}}}};
}

nlohmann::ordered_json pose_json(const SE3& T) {
  Json rows = Json::array();
  const Eigen::Matrix4d M = T.matrix();
  for (int r = 0; r < 4; ++r) rows.push_back({M(r, 0), M(r, 1), M(r, 2), M(r, 3)});
  return rows;
}

PoseError start_error(const Camera& camera, const Features& features, const SE3& T_10) {
  return pose_error(camera, features, SE3(), T_10);
}

uint64_t largest_pair(const Camera& camera, const Camera& second, int features, int depths) {
  const auto pixels = [](const Camera& c) { return static_cast<uint64_t>(c.width) * static_cast<uint64_t>(c.height); };
  const auto colour = 3 * (pixels(camera) + pixels(second)), depth = 4 * (pixels(camera) + (depths > 1 ? pixels(second) : 0));
  return colour + depth + 48 * static_cast<uint64_t>(features) + (16 << 10);
}

std::string encode_view(const View& view) {
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  cv::Mat bgr;
  cv::cvtColor(rgba, bgr, cv::COLOR_RGBA2BGR);
  return encode_png(bgr);
}

std::string encode_depth(const View& view) {
  const cv::Mat depth(view.height, view.width, CV_32FC1, const_cast<float*>(view.depth.data()));
  std::vector<uchar> bytes;
  if (!cv::imencode(".tiff", depth, bytes)) throw Error(ErrorCode::unsupported, "OpenCV cannot encode depth as TIFF");
  return {bytes.begin(), bytes.end()};
}

}  // namespace iclk
