#pragma once
#include <sstream>

#include <iclk/engine/error.h>

namespace iclk {

/// Throws Error(invalid_argument) naming the option, its value and the range, unless low <= value <= high (a NaN is outside).
inline void check_range(const char* option, double value, double low, double high) {
  if (value >= low && value <= high) return;
  std::ostringstream why;
  why << option << " is " << value << ", must be " << low << " to " << high;
  throw Error(ErrorCode::invalid_argument, why.str());
}

}  // namespace iclk
