#pragma once
#include <string>
#include <string_view>
#include <vector>

namespace iclk::internal {

/// A JSON value.
struct Json {
  enum class Kind { null, boolean, number, string, array, object };
  Kind kind = Kind::null;
  bool boolean = false;
  double number = 0;
  std::string string;             ///< UTF-8
  std::vector<Json> items;        ///< of an array, or the values of an object
  std::vector<std::string> keys;  ///< of an object, one per item, all different

  const Json* find(std::string_view key) const;  ///< null: no such key
  /// Throws Error(invalid_argument) "`what` must be an integer from 0 to `most`".
  size_t integer(const std::string& what, size_t most) const;
};

/// Parses strict JSON (RFC 8259) in UTF-8: one value, blanks around it, no duplicate keys, at most `max_depth` levels of
/// nesting. Throws Error(invalid_argument) with the byte and the error.
Json parse_json(std::string_view text, int max_depth);

std::string json_string(std::string_view utf8);  ///< in quotes, escaped

}  // namespace iclk::internal
