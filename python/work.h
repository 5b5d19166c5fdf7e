#pragma once
#include <unistd.h>

#include <memory>
#include <mutex>
#include <optional>

#include <nanobind/nanobind.h>

namespace iclk::python {

/// From construction to destruction the thread works without the GIL. What is under way when the interpreter ends is waited
/// for (finish_work), since a thread that asks for the GIL later is ended in the middle of our frames.
class Working {
 public:
  /// Precondition: the GIL is held. Once the interpreter is ending it throws Error(unsupported) in the thread that ends it, and
  /// never returns in another.
  Working();
  ~Working();
  Working(const Working&) = delete;
  Working& operator=(const Working&) = delete;

 private:
  std::optional<nanobind::gil_scoped_release> released_;
};

/// Lets nothing begin any more and waits for what is under way. Precondition: the GIL is held.
void finish_work();

/// Throws what a signal's handler raised: KeyboardInterrupt. Precondition: the GIL is held.
void check_signals();

/// Throws Error(unsupported) that says in which process to make one.
[[noreturn]] void refuse_forked(const char* what);

/// An object with Vulkan behind it, which the process that made it may use, one thread at a time. In a forked process its
/// threads and its device are gone: there it can be neither used nor destroyed.
template <class T>
class Owned {
 public:
  explicit Owned(const char* what) : what_(what) {}
  ~Owned() {
    if (made_by_ != getpid()) static_cast<void>(object_.release());
  }
  Owned(const Owned&) = delete;
  Owned& operator=(const Owned&) = delete;

  void reset(std::unique_ptr<T> object) {
    check();
    object_ = std::move(object);
  }
  T* get() const { return object_.get(); }
  /// Throws Error(unsupported) in a forked process.
  void check() const {
    if (made_by_ != getpid()) refuse_forked(what_);
  }
  /// Throws as check(). To be called without the GIL: another thread may be at work for long.
  std::unique_lock<std::mutex> lock() {
    check();
    return std::unique_lock(mutex_);
  }

 private:
  const char* what_;
  const pid_t made_by_ = getpid();
  std::unique_ptr<T> object_;
  std::mutex mutex_;
};

}  // namespace iclk::python
