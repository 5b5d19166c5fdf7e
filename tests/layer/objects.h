#pragma once
#include <map>
#include <mutex>

#include "control.h"

namespace iclk::test {

/// Handles that live, by type.
class Objects {
 public:
  /// `bytes`: of device memory.
  void created(const char* type, uint64_t handle, uint64_t bytes = 0);
  /// False, and a line of misuse, for a handle that is not alive: the call must not be handed down.
  bool destroyed(const char* type, uint64_t handle);

  LiveObjects live() const;
  void misuse(const std::string& text);
  std::vector<std::string> take_misuse();

 private:
  mutable std::mutex mutex_;
  std::map<std::string, std::multimap<uint64_t, uint64_t>> live_;  // type: handle: bytes; drivers may give a handle twice
  std::vector<std::string> misuse_;
};

}  // namespace iclk::test
