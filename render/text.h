#pragma once
#include <cstdio>
#include <string>

namespace iclk::internal {

/// A number as messages have it.
inline std::string number(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

}  // namespace iclk::internal
