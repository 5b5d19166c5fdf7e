#include "apps/iclk/batch/inputs.h"

#include <sys/stat.h>

#include <ctime>

#include <iclk/session/io/text.h>

#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

/// Size and time alone: to read a file again only to see that it is the same would take as long as to align it.
Json file_state(const std::string& path) {
  struct stat info = {};
  if (::stat(path.c_str(), &info) != 0) return nullptr;
  if (!S_ISREG(info.st_mode)) return Json::object();  // a pipe is another one every time
  std::tm utc = {};
  ::gmtime_r(&info.st_mtim.tv_sec, &utc);
  char seconds[40];
  std::strftime(seconds, sizeof seconds, "%Y-%m-%dT%H:%M:%S", &utc);
  return {{"bytes", static_cast<uint64_t>(info.st_size)},
          {"modified", formatted("%s.%09ldZ", seconds, static_cast<long>(info.st_mtim.tv_nsec))}};
}

std::string in_words(const Json& value) {
  if (value.is_null()) return "missing";
  if (value.is_string()) return value.get<std::string>();
  if (value.is_object() && value.contains("bytes") && value.contains("modified"))
    return value["bytes"].dump() + " bytes of " + value["modified"].dump();
  return value.dump();
}

}  // namespace

LineInputs line_inputs(const PairRequest& request, const InputOptions& options) {
  LineInputs inputs;
  const Camera& c = options.camera.camera;
  const Distortion distortion = options.distortion.value_or(options.camera.distortion);
  inputs.values = {{"camera", {c.fx, c.fy, c.cx, c.cy, c.width, c.height}},
                   {"distortion", distortion_text(distortion)},
                   {"depth_scale", options.depth_scale}};
  const PairFiles& files = request.files;
  const std::pair<const char*, const std::string&> all[] = {{"reference", files.reference},
                                                            {"target", files.target},
                                                            {"depth", files.depth},
                                                            {"features", files.features},
                                                            {"reference_mask", files.reference_mask},
                                                            {"target_mask", files.target_mask},
                                                            {"mask", options.mask},
                                                            {"initial_pose", request.T_10_file},
                                                            {"truth", request.truth_file}};
  for (const auto& [name, path] : all) {
    if (path.empty()) continue;
    inputs.values[name] = file_state(path);
    inputs.paths[name] = path;
  }
  return inputs;
}

std::string changed_input(const Json& then, const LineInputs& now) {
  if (!then.is_object() || !now.values.is_object()) return "";
  for (const auto& [name, value] : now.values.items()) {
    const auto old = then.find(name);
    if (old == then.end() || *old == value || value.is_null()) continue;
    const auto path = now.paths.find(name);
    return "its " + name + (path == now.paths.end() ? "" : " " + path->second) + " was " + in_words(*old) + ", now it is " +
           in_words(value);
  }
  return "";
}

}  // namespace iclk
