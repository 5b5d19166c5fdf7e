#pragma once
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace iclk {

/// The subset of YAML that camera files of Kalibr, EuRoC, ROS and OpenCV use: nested maps by indentation, scalars, flow
/// sequences `[a, b]` (over several lines; nested ones are flattened), block sequences of scalars, comments, tags, quotes.
class Yaml {
 public:
  /// Throws Error(invalid_argument) "`path`:`line`: ..." for other YAML.
  Yaml(std::string_view text, const std::string& path);

  /// The values of a dotted key ("cam0.intrinsics"); nullptr if it is missing.
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

/// Returns `text`, from which `yaml` was parsed, with a new value of a dotted key. An empty `value` removes the key. All other
/// text is unchanged, including comments between the lines of the value. A missing key changes nothing.
std::string with_value(const std::string& text, const Yaml& yaml, const std::string& key, const std::string& value);

}  // namespace iclk
