#include "objects.h"

#include <utility>

namespace iclk::test {

void Objects::created(const char* type, uint64_t handle, uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  live_[type].emplace(handle, bytes);
}

bool Objects::destroyed(const char* type, uint64_t handle) {
  const std::lock_guard lock(mutex_);
  auto& handles = live_[type];
  const auto found = handles.find(handle);
  if (found == handles.end()) {
    misuse_.push_back(std::string(type) + " destroyed that is none");
    return false;
  }
  handles.erase(found);
  return true;
}

LiveObjects Objects::live() const {
  const std::lock_guard lock(mutex_);
  LiveObjects result;
  for (const auto& [type, handles] : live_) {
    if (handles.empty()) continue;
    result.handles += handles.size();
    for (const auto& [handle, bytes] : handles) result.device_bytes += bytes;
    result.names += (result.names.empty() ? "" : ", ") + std::to_string(handles.size()) + " " + type;
  }
  return result;
}

void Objects::misuse(const std::string& text) {
  const std::lock_guard lock(mutex_);
  misuse_.push_back(text);
}

std::vector<std::string> Objects::take_misuse() {
  const std::lock_guard lock(mutex_);
  return std::exchange(misuse_, {});
}

}  // namespace iclk::test
