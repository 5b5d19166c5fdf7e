#pragma once
#include <algorithm>
#include <limits>
#include <vector>

namespace iclk {

/// The mean of the middle two for an even count; NaN for none. Infinite values sort last.
inline double median(std::vector<double> values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(values.begin(), values.end());
  const size_t half = values.size() / 2;
  return values.size() % 2 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

}  // namespace iclk
