#pragma once
#include <cstdio>
#include <string>

namespace iclk::internal {

/// Formats a number for messages.
inline std::string number(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

}  // namespace iclk::internal
