#pragma once
#include <mutex>
#include <optional>

#include "control.h"

namespace iclk::test {

/// Counts calls and says which one fails.
class Faults {
 public:
  Faults();
  const std::vector<LayerCall>& calls() const { return calls_; }
  /// Index into calls(). Precondition: the name is there.
  size_t index(const std::string& call) const;

  void arm(size_t call, uint32_t ordinal, VkResult result, uint32_t times);
  void disarm();
  bool fired() const;
  uint32_t count(size_t call) const;

  /// To be asked once a call; what to return instead of calling down.
  std::optional<VkResult> next(size_t call);
  bool may_lose_device(size_t call) const;

 private:
  std::vector<LayerCall> calls_;
  mutable std::mutex mutex_;
  std::vector<uint32_t> counts_;
  size_t armed_;  // calls_.size(): none
  uint32_t ordinal_ = 0, times_ = 0;
  VkResult result_ = VK_SUCCESS;
  bool fired_ = false;
};

}  // namespace iclk::test
