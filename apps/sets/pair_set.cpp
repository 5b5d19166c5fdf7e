#include "apps/sets/pair_set.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/statvfs.h>
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

#include "apps/io/feature_csv.h"
#include "apps/io/images.h"
#include "apps/io/json.h"
#include "apps/io/output.h"
#include "apps/io/text.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr int kVersion = 1;

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

std::string id_of(uint64_t index) {
  char text[24];
  std::snprintf(text, sizeof text, "%06llu", static_cast<unsigned long long>(index));
  return text;
}

/// Throws if the two differ in any key, with the first.
void compare_options(const std::string& path, const Json& old, const Json& now) {
  for (const Json* both : {&old, &now})
    for (const auto& [name, unused] : both->items()) {
      const auto a = old.find(name), b = now.find(name);
      const auto shown = [](const auto& value, const Json& in) { return value == in.end() ? "nothing" : value->dump(); };
      if (a == old.end() || b == now.end() || *a != *b)
        refuse(path + " was begun with " + name + " " + shown(a, old) + ", now it is " + shown(b, now) +
               ": give the same to continue, or another --out");
    }
}

}  // namespace

PairSet::PairSet(const std::string& folder, const Json& options, const Json& about) : folder_(folder) {
  make_output_folder(folder);
  const std::string path = folder + "/set.json";
  if (!fs::exists(path)) {
    for (const auto& entry : fs::directory_iterator(folder))
      if (!entry.path().filename().string().starts_with("set.json.part"))
        refuse(folder + " holds other files (" + printable(entry.path().filename().string()) +
               ") and no set.json: give an empty or new folder as --out");
    write_file(path, Json{{"iclk_pairs", kVersion}, {"options", options}, {"about", about}}.dump(2) + "\n");
  } else {
    std::string why;
    const Json old = parse_json(read_file(path), &why);
    if (!old.is_object() || old.value("iclk_pairs", 0) != kVersion || !old.contains("options") || !old["options"].is_object())
      refuse(path + " is damaged or not of a set of this version" + (why.empty() ? "" : " (" + why + ")") +
             ": give another --out");
    compare_options(path, old["options"], options);
  }
  for (const char* name : {"images", "depth", "features"}) make_output_folder(folder + "/" + name);
  try {
    open_manifest();
    // What a kill left half written has a name of its own.
    for (const char* name : {"images", "depth", "features"})
      for (const auto& entry : fs::directory_iterator(folder + "/" + name))
        if (entry.path().filename().string().find(".part") != std::string::npos) fs::remove(entry.path());
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
    if (!lines_.emplace(index, std::move(json)).second)
      refuse(manifest() + ":" + std::to_string(number) + ": pair " + std::to_string(index) + " comes twice");
  }
  if (whole != text.size() && ::ftruncate(file_, static_cast<off_t>(whole)) != 0)
    throw Error(ErrorCode::io, "cannot write " + manifest() + ": " + std::strerror(errno));
}

uint64_t PairSet::free_bytes() const {
  struct statvfs info = {};
  if (::statvfs(folder_.c_str(), &info) != 0) return UINT64_MAX;
  return uint64_t{info.f_bavail} * info.f_frsize;
}

void PairSet::add(uint64_t index, const RenderedPair& pair, const Camera& camera, const Features& features, bool target_depth) {
  const std::string id = id_of(index);
  const std::string image0 = "images/" + id + "_0.png", image1 = "images/" + id + "_1.png", depth = "depth/" + id + ".tiff",
                    points = "features/" + id + ".csv";
  write_file(folder_ + "/" + image0, encode_view(pair.view0));
  write_file(folder_ + "/" + image1, encode_view(pair.view1));
  write_file(folder_ + "/" + depth, encode_depth(pair.view0));
  write_file(folder_ + "/" + points, features_csv(features));
  const PoseError start = start_error(camera, features, pair.T_10);
  Json line = {{"id", id},
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
  if (target_depth) {
    const std::string depth1 = "depth/" + id + "_1.tiff";
    write_file(folder_ + "/" + depth1, encode_depth(pair.view1));
    line["meta"]["target_depth"] = depth1;
  }
  const std::string text = line.dump() + "\n";
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
  lines_.emplace(index, std::move(line));
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

uint64_t largest_pair(const Camera& camera, int features, bool target_depth) {
  const auto pixels = static_cast<uint64_t>(camera.width) * static_cast<uint64_t>(camera.height);
  return pixels * (target_depth ? 14 : 10) + 48 * static_cast<uint64_t>(features) + (16 << 10);
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
