#include "apps/eval/common/machine.h"

#include <sched.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <thread>

#include <opencv2/core/utility.hpp>

#include <iclk/align/common/stopwatch.h>

#include "apps/iclk/common/cpu_stopwatch.h"
#include "apps/iclk/common/median.h"
#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

int usable_cores() {
  cpu_set_t set;
  CPU_ZERO(&set);
  if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
  return static_cast<int>(std::thread::hardware_concurrency());
}

double measure_cores(int cores) {
  const internal::Stopwatch wall;
  const CpuStopwatch cpu;
  std::vector<std::thread> threads;
  for (int i = 0; i < cores; ++i)
    threads.emplace_back([&wall] {
      while (wall.ms() < 250) {
      }
    });
  for (std::thread& thread : threads) thread.join();
  return cpu.ms() / wall.ms();
}

std::string processor_name() {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);)
    if (line.rfind("model name", 0) == 0 && line.find(':') != std::string::npos)
      return line.substr(std::min(line.size(), line.find(':') + 2));
  return "unknown processor";
}

}  // namespace

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

}  // namespace iclk
