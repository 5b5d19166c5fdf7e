#pragma once
#include <vector>

namespace iclk {

/// Seconds a unit of a recording's times, in order: by the magnitude of times since 1970 (seconds, milliseconds, microseconds,
/// nanoseconds; since 1601 in 100 ns), else, of whole numbers, by their spacing, which is 2 ms to 2 s from frame to frame; 1 of
/// others. `usual`: of whole numbers, that of a list beside it, if it is not 0.
double time_unit(const std::vector<double>& times, double usual = 0);

}  // namespace iclk
