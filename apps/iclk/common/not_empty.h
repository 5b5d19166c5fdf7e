#pragma once
#include <string>

namespace iclk {

/// A check for options: an empty value is a shell variable that was never set, not a wish.
inline std::string not_empty(const std::string& value) { return value.empty() ? "the value is empty" : ""; }

}  // namespace iclk
