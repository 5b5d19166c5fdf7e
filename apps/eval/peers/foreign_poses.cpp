#include "apps/eval/peers/foreign_poses.h"

#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/refuse.h"

namespace iclk {
namespace {

ForeignPoses::Pose pose_of(const nlohmann::json& line, const std::string& where) {
  ForeignPoses::Pose pose;
  const auto T = line.find("T_10"), claimed = line.find("claimed"), status = line.find("status"), ms = line.find("ms");
  if (T != line.end() && !T->is_null()) {
    if (!T->is_array()) refuse(where + ": key 'T_10' is " + printable(T->dump()) + "; it must be a 4x4 nested list or null");
    pose.T_10 = parse_pose(T->dump(), where + ": key 'T_10'");
    pose.has_pose = true;
  }
  if (claimed != line.end()) {
    if (!claimed->is_boolean())
      refuse(where + ": key 'claimed' is " + printable(claimed->dump()) + "; it must be true or false");
    pose.claimed = claimed->get<bool>();
  } else {
    pose.claimed = status == line.end() ? pose.has_pose : *status == "converged";
  }
  pose.claimed = pose.claimed && pose.has_pose;
  pose.ms = ms != line.end() && ms->is_number() ? ms->get<double>() : std::numeric_limits<double>::quiet_NaN();
  return pose;
}

}  // namespace

ForeignPoses::ForeignPoses(const std::string& argument) {
  const size_t equals = argument.find('=');
  if (equals == 0 || equals == std::string::npos || equals + 1 == argument.size())
    refuse("--peer-results '" + printable(argument) + "' must be NAME=FILE, such as 'XFeat + LighterGlue=xfeat.jsonl'");
  name_ = argument.substr(0, equals);
  path_ = argument.substr(equals + 1);
  const std::string bytes = read_file(path_, size_t{4} << 30);
  int number = 0;
  for (const std::string_view raw : lines_of(bytes)) {
    const std::string where = path_ + ":" + std::to_string(++number);
    const std::string_view text = trim(raw);
    if (text.empty()) continue;
    const auto line = nlohmann::json::parse(text, nullptr, false);
    if (!line.is_object()) refuse(where + ": not a JSON object");
    const auto id = line.find("id");
    if (id == line.end()) continue;
    if (!id->is_string() && !id->is_number_integer()) refuse(where + ": key 'id' is " + printable(id->dump()));
    const std::string key = id->is_string() ? id->get<std::string>() : id->dump();
    if (!poses_.emplace(key, pose_of(line, where)).second) refuse(where + ": id '" + printable(key) + "' appears twice");
  }
}

const ForeignPoses::Pose& ForeignPoses::of(const std::string& id) const {
  const auto found = poses_.find(id);
  if (found == poses_.end())
    refuse(
        path_ + ": no line has the id '" + printable(id) +
        "'; every pair needs one, with T_10 null where there is no pose. `iclk eval --export` with the same options writes the "
        "pairs by these ids");
  return found->second;
}

}  // namespace iclk
