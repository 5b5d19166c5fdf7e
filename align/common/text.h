#pragma once
#include <string>
#include <string_view>

namespace iclk::internal {

/// Formats a number without trailing zeros, in every locale the same way: 16, not 16.000000.
std::string text_of(double value);

/// The shortest text that parses to this number.
std::string exact_text(float value);
std::string exact_text(double value);

/// Untrusted text for messages: in quotes, short and printable.
std::string in_quotes(std::string_view text);

}  // namespace iclk::internal
