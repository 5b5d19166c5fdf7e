#pragma once
#include <algorithm>
#include <cstddef>
#include <future>
#include <thread>
#include <vector>

namespace iclk::internal {

/// The number of cores that this process may use. It is cached, because the query takes tens of microseconds.
inline size_t cores() {
  static const size_t known = std::max(1u, std::thread::hardware_concurrency());
  return known;
}

/// Calls each(0) to each(n - 1) once each, in up to `threads` threads including this one; 0: one per usable core. It uses fewer
/// threads if no more can be started. After all have ended, it rethrows the error of one of them. Precondition: calls may run
/// at the same time.
template <class Each>
void for_each_of(size_t n, int threads, const Each& each) {
  const size_t parts = std::min(n, threads > 0 ? static_cast<size_t>(threads) : cores());
  const auto part = [&](size_t first) {
    for (size_t i = first; i < n; i += parts) each(i);
  };
  std::vector<std::future<void>> others;
  for (size_t k = 1; k < parts; ++k) others.push_back(std::async(std::launch::async | std::launch::deferred, part, k));
  if (parts > 0) part(0);
  for (std::future<void>& other : others) other.get();
}

}  // namespace iclk::internal
