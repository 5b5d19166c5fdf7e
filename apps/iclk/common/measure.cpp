#include "apps/iclk/common/measure.h"

#include <sched.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <thread>

#include <opencv2/core/utility.hpp>

#include "apps/json/format.h"

namespace iclk {
namespace {

double wall_now() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double cpu_now() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto ms = [](const timeval& t) { return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec); };
  return ms(usage.ru_utime) + ms(usage.ru_stime);
}

int usable_cores() {
  cpu_set_t set;
  CPU_ZERO(&set);
  if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
  return static_cast<int>(std::thread::hardware_concurrency());
}

double measure_cores(int cores) {
  const Stopwatch watch;
  std::vector<std::thread> threads;
  for (int i = 0; i < cores; ++i)
    threads.emplace_back([&watch] {
      while (watch.wall_ms() < 250) {
      }
    });
  for (std::thread& thread : threads) thread.join();
  return watch.cpu_ms() / watch.wall_ms();
}

std::string processor_name() {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);)
    if (line.rfind("model name", 0) == 0 && line.find(':') != std::string::npos)
      return line.substr(std::min(line.size(), line.find(':') + 2));
  return "unknown processor";
}

}  // namespace

void Stopwatch::restart() {
  wall_ = wall_now();
  cpu_ = cpu_now();
}

double Stopwatch::wall_ms() const { return wall_now() - wall_; }
double Stopwatch::cpu_ms() const { return cpu_now() - cpu_; }

double median(std::vector<double> values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(values.begin(), values.end());
  const size_t half = values.size() / 2;
  return values.size() % 2 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

Spread spread(const std::vector<double>& values) {
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  return values.empty() ? Spread() : Spread{median(values), *low, *high};
}

Machine describe_machine(const engine::Context* context) {
  Machine machine;
  if (getloadavg(&machine.load, 1) != 1) machine.load = std::numeric_limits<double>::quiet_NaN();
  machine.device = context ? context->info().name : "no Vulkan device";
  machine.driver = context ? context->info().driver_name : "";
  machine.processor = processor_name();
  machine.cores = usable_cores();
  machine.cores_got = measure_cores(machine.cores);
  machine.opencv_threads = cv::getNumThreads();
  return machine;
}

nlohmann::ordered_json to_json(const Machine& m) {
  return {{"device", m.device},
          {"driver", m.driver},
          {"processor", m.processor},
          {"cores", m.cores},
          {"cores_got", number(m.cores_got)},
          {"opencv_threads", m.opencv_threads},
          {"load_average", number(m.load)}};
}

std::string to_line(const Machine& m) {
  return formatted("%s%s%s; %s, %d cores of which this process got %.1f, load average %.1f\n", m.device.c_str(),
                   m.driver.empty() ? "" : ", driver ", m.driver.c_str(), m.processor.c_str(), m.cores, m.cores_got, m.load);
}

Progress terminal_progress() {
  if (!isatty(STDERR_FILENO)) return [](const std::string&, int, int) {};
  return [](const std::string& what, int done, int total) {
    constexpr int kWidth = 30;
    const int filled = total > 0 ? kWidth * done / total : 0;
    if (done >= total)
      std::fprintf(stderr, "\r\x1b[K");
    else
      std::fprintf(stderr, "\r\x1b[K[%s%s] %d/%d %s", std::string(static_cast<size_t>(filled), '#').c_str(),
                   std::string(static_cast<size_t>(kWidth - filled), '.').c_str(), done, total, what.c_str());
    std::fflush(stderr);
  };
}

nlohmann::ordered_json number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

}  // namespace iclk
