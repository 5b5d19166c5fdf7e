#pragma once
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace iclk {

/// The part of YAML that camera files are written in: nested maps by indentation, scalars, flow sequences `[a, b]` (over
/// several lines, nested ones flattened), block sequences of scalars, comments, tags, quotes. Kalibr, EuRoC, ROS, OpenCV.
class Yaml {
 public:
  /// Throws Error(invalid_argument) "<path>:<line>: ..." for what is not of that kind.
  Yaml(std::string_view text, const std::string& path);

  /// Values under a dotted key ("cam0.intrinsics"); nullptr where it is missing.
  const std::vector<std::string>* find(const std::string& key) const;
  bool has_children(const std::string& key) const;

 private:
  std::map<std::string, std::vector<std::string>> values_;
};

}  // namespace iclk
