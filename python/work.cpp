#include "python/work.h"

#include <pthread.h>

#include <atomic>
#include <chrono>
#include <string>
#include <thread>

#include <iclk/engine/error.h>

namespace nb = nanobind;

namespace iclk::python {
namespace {

std::atomic<int> pending = 0;
std::atomic<bool> ending = false;
std::thread::id ended_by;

/// The threads that were at work are not in a forked process.
const int registered = pthread_atfork(nullptr, nullptr, [] { pending = 0; });

}  // namespace

Working::Working() {
  static_cast<void>(registered);
  if (ending) {
    if (std::this_thread::get_id() == ended_by)
      throw Error(ErrorCode::unsupported, "the interpreter is shutting down: no new work is started");
    // A daemon thread. What it would print of an exception while the interpreter goes can abort the process, so it waits for
    // the end, as CPython 3.14 lets it do by itself.
    const nb::gil_scoped_release released;
    for (;;) pause();
  }
  ++pending;
  released_.emplace();
}

Working::~Working() {
  released_.reset();
  --pending;
}

void finish_work() {
  ended_by = std::this_thread::get_id();
  ending = true;
  const nb::gil_scoped_release released;
  while (pending > 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

void check_signals() {
  if (PyErr_CheckSignals() != 0) throw nb::python_error();
}

void refuse_forked(const char* what) {
  throw Error(ErrorCode::unsupported, std::string("this ") + what +
                                          " was made before the process was forked, and a device does not survive a fork: make "
                                          "it in the worker, or start workers with multiprocessing's 'spawn'");
}

}  // namespace iclk::python
