#pragma once
#include <string>
#include <string_view>

namespace iclk::internal {

/// A number as a person writes it, whatever the locale: 16, not 16.000000.
std::string text_of(double value);

/// The shortest text that is read back as this number.
std::string exact_text(float value);
std::string exact_text(double value);

/// Foreign text as it may stand in a message: in quotes, short and printable.
std::string in_quotes(std::string_view text);

}  // namespace iclk::internal
