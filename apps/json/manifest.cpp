#include "apps/json/manifest.h"

#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <unordered_map>

#include <iclk/engine/error.h>
#include <iclk/session/io/pose_text.h>

#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::array kKeys = {"id",          "reference",   "target", "depth",      "features",     "reference_mask",
                              "target_mask", "depth_scale", "camera", "distortion", "initial_pose", "truth",
                              "meta"};

[[noreturn]] void fail(const std::string& where, const std::string& why) {
  throw Error(ErrorCode::invalid_argument, where + ": " + why);
}

std::string id_of(std::string_view text, int number) {
  const std::string unknown = "line " + std::to_string(number);
  const Json json = parse_json(text);
  if (!json.is_object()) return unknown;
  const auto id = json.find("id");
  if (id == json.end() || id->is_null()) return std::to_string(number);
  if (id->is_number_integer()) return id->dump();
  return id->is_string() && !id->get_ref<const std::string&>().empty() ? id->get<std::string>() : unknown;
}

Json parse_object(const std::string& text, const std::string& where) {
  std::string why;
  Json json = parse_json(text, &why);
  if (json.is_discarded()) fail(where, why);
  if (!json.is_object()) fail(where, std::string("must be a JSON object {...}, not a ") + json.type_name());
  return json;
}

/// The keys of one line.
struct Line {
  const Json& json;
  const std::string& where;
  const std::string& folder;
  const FileReader& read;

  const Json* find(const char* key) const {
    const auto found = json.find(key);
    return found == json.end() || found->is_null() ? nullptr : &*found;
  }
  std::string text(const char* key) const {
    const Json* value = find(key);
    if (value == nullptr) return "";
    if (!value->is_string() || value->get_ref<const std::string&>().empty())
      fail(where, std::string("key '") + key + "' is " + printable(value->dump()) + ", not a string");
    return value->get<std::string>();
  }
  std::string path(const std::string& file) const { return (std::filesystem::path(folder) / file).string(); }
  std::string file(const char* key) const {
    const std::string name = text(key);
    return name.empty() ? name : path(name);
  }
  std::string required_file(const char* key) const {
    if (find(key) == nullptr) fail(where, std::string("key '") + key + "' is missing");
    return file(key);
  }
  std::optional<std::string> camera() const {
    const Json* value = find("camera");
    if (value == nullptr) return std::nullopt;
    if (value->is_array()) {
      std::string numbers = value->dump();
      return numbers.substr(1, numbers.size() - 2);
    }
    const std::string camera = text("camera");
    const bool numbers = camera.find_first_not_of("0123456789.,+-eE \t") == std::string::npos;
    return numbers ? camera : path(camera);
  }
  std::optional<SE3> pose(const char* key, std::string& file) const {
    const Json* value = find(key);
    if (value == nullptr) return std::nullopt;
    const std::string what = where + ": key '" + key + "'";
    if (value->is_array()) return parse_pose(value->dump(), what);
    const std::string pose = text(key);
    const bool numbers = pose.find_first_not_of("0123456789.,;+-eE \t\r\n[]") == std::string::npos;
    if (numbers) return parse_pose(pose, what);
    file = path(pose);
    return load_pose(file, what, read);
  }
};

}  // namespace

std::string hash_of(std::string_view text) { return formatted("%016llx", static_cast<unsigned long long>(fnv1a(text))); }

Manifest read_manifest(const std::string& path) {
  Manifest manifest;
  manifest.path = path;
  manifest.folder = std::filesystem::path(path).parent_path().string();
  const std::string bytes = read_file(path, size_t{4} << 30);
  std::unordered_map<std::string, int> first;
  int number = 0;
  for (const std::string_view raw : lines_of(bytes)) {
    ++number;
    const std::string_view text = trim(raw);
    if (text.empty()) continue;
    ManifestLine line{number, id_of(text, number), hash_of(text), std::string(text)};
    const auto [other, is_new] = first.emplace(line.id, number);
    if (!is_new)
      fail(path, "lines " + std::to_string(other->second) + " and " + std::to_string(number) + " have the same id '" +
                     printable(line.id) + "' (the default is the line number); every pair needs its own");
    manifest.lines.push_back(std::move(line));
  }
  if (manifest.lines.empty()) fail(path, "has no pairs; a line is {\"reference\": ..., \"target\": ..., \"depth\": ...}");
  return manifest;
}

PairRequest parse_line(const Manifest& manifest, const ManifestLine& line) {
  return parse_request(line.text, place(manifest, line), manifest.folder);
}

PairRequest parse_request(const std::string& text, const std::string& where, const std::string& folder,
                          const FileReader& read) {
  const Json json = parse_object(text, where);
  const Line line{json, where, folder, read};
  for (const auto& [key, value] : json.items()) {
    if (std::find(kKeys.begin(), kKeys.end(), key) != kKeys.end()) continue;
    std::string known;
    for (const char* k : kKeys) known += (known.empty() ? "" : ", ") + std::string(k);
    fail(where, "unknown key '" + printable(key) + "'; known are " + known + "; put your own data into \"meta\"");
  }
  if (const Json* id = line.find("id"); id != nullptr && !id->is_number_integer()) line.text("id");
  PairRequest request;
  request.files.reference = line.required_file("reference");
  request.files.target = line.required_file("target");
  request.files.depth = line.file("depth");
  request.files.features = line.file("features");
  request.files.reference_mask = line.file("reference_mask");
  request.files.target_mask = line.file("target_mask");
  if (request.files.depth.empty() && request.files.features.empty()) fail(where, "key 'depth' or 'features' is missing");
  request.camera = line.camera();
  if (line.find("distortion") != nullptr) request.distortion = line.text("distortion");
  if (const Json* scale = line.find("depth_scale")) {
    if (!scale->is_number() || !(scale->get<double>() > 0) || !std::isfinite(scale->get<double>()))
      fail(where, "key 'depth_scale' is " + printable(scale->dump()) + "; it must be a positive number");
    request.depth_scale = scale->get<double>();
  }
  request.T_10 = line.pose("initial_pose", request.T_10_file);
  request.truth = line.pose("truth", request.truth_file);
  if (const Json* meta = line.find("meta")) request.meta = *meta;
  return request;
}

std::string place(const Manifest& manifest, const ManifestLine& line) {
  return manifest.path + ":" + std::to_string(line.number);
}

Shard parse_shard(const std::string& text) {
  Shard shard;
  const char* const end = text.data() + text.size();
  const auto k = std::from_chars(text.data(), end, shard.k);
  bool good = k.ec == std::errc() && k.ptr != end && *k.ptr == '/';
  if (good) {
    const auto n = std::from_chars(k.ptr + 1, end, shard.n);
    good = n.ec == std::errc() && n.ptr == end && shard.k >= 0 && shard.k < shard.n;
  }
  if (!good)
    throw Error(ErrorCode::invalid_argument, "shard '" + printable(text) + "' is not k/n with 0 <= k < n, such as 0/4");
  return shard;
}

}  // namespace iclk
