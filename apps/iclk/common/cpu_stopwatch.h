#pragma once
#include <sys/resource.h>

namespace iclk {

/// Processor time (user and system) of all threads of this process since it was made: what other processes hardly disturb. A
/// software device runs in this process, a GPU does not.
class CpuStopwatch {
 public:
  double ms() const { return now() - start_; }

 private:
  static double now() {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto ms = [](const timeval& t) {
      return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec);
    };
    return ms(usage.ru_utime) + ms(usage.ru_stime);
  }

  double start_ = now();
};

}  // namespace iclk
