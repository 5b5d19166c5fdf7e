#pragma once
#include <string>

namespace iclk {

/// printf to a string.
[[gnu::format(printf, 1, 2)]] std::string formatted(const char* format, ...);

}  // namespace iclk
