#include "apps/iclk/io/time_unit.h"

#include <algorithm>
#include <cmath>

namespace iclk {
namespace {

constexpr double kYear2001 = 1e9, kYear2103 = 4.2e9;                         // s since 1970
constexpr double kTicks = 1e-7, kTicks2001 = 1.26e10, kTicks2103 = 1.59e10;  // s since 1601
constexpr double kRarest = 20, kSlowest = 2;                                 // s from frame to frame
constexpr double kUnits[] = {1, 1e-3, 1e-6, 1e-9};

double median_step(const std::vector<double>& times) {
  std::vector<double> steps;
  for (size_t i = 1; i < times.size(); ++i) steps.push_back(times[i] - times[i - 1]);
  if (steps.empty()) return 0;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle;
}

}  // namespace

double time_unit(const std::vector<double>& times, double usual) {
  if (times.empty()) return 1;
  const double step = median_step(times);
  for (const double unit : kUnits)
    if (times[0] * unit >= kYear2001 && times[0] * unit < kYear2103 && step * unit < kRarest) return unit;
  if (times[0] * kTicks >= kTicks2001 && times[0] * kTicks < kTicks2103 && step * kTicks < kRarest) return kTicks;
  const bool whole = std::all_of(times.begin(), times.end(), [](double t) { return t == std::floor(t); });
  if (!whole) return 1;
  if (usual > 0) return usual;
  for (const double unit : kUnits)
    if (step * unit < kSlowest) return unit;
  return 1;
}

}  // namespace iclk
