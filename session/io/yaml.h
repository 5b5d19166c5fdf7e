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
  friend std::string with_value(const std::string&, const Yaml&, const std::string&, const std::string&);
  struct Value {
    std::vector<std::string> words;
    int first = 0, last = 0;  ///< lines of the text, from 0
  };
  std::map<std::string, Value> values_;
};

/// The text that `yaml` was read from with another value of that dotted key, or, where `value` is empty, without key and value.
/// All else stays, comments among the value's lines too. A key that is not there changes nothing.
std::string with_value(const std::string& text, const Yaml& yaml, const std::string& key, const std::string& value);

}  // namespace iclk
