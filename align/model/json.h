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
  std::vector<std::string> keys;  ///< of an object, one an item; no two are the same

  const Json* find(std::string_view key) const;  ///< null: no such key
  /// Throws Error(invalid_argument) "<what> must be an integer from 0 to <most>".
  size_t integer(const std::string& what, size_t most) const;
};

/// Strict JSON (RFC 8259), one value that fills the text but for blanks, UTF-8, no key twice, nested at most `max_depth` deep.
/// Throws Error(invalid_argument) that says at which byte what is wrong.
Json parse_json(std::string_view text, int max_depth);

std::string json_string(std::string_view utf8);  ///< in quotes, escaped

}  // namespace iclk::internal
