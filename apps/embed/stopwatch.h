#pragma once
#include <vector>

#include "apps/embed/host.h"

namespace embed {

/// Timestamps in the application's command buffer. Does nothing where the queue has none.
class Stopwatch {
 public:
  Stopwatch(Host& host, uint32_t stamps);
  ~Stopwatch();
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;

  void record_start(VkCommandBuffer commands);
  /// When everything before has finished.
  void record(VkCommandBuffer commands);
  /// After the submission: ms from each stamp to the next.
  std::vector<double> read() const;

 private:
  Host& host_;
  VkQueryPool pool_ = VK_NULL_HANDLE;
  uint32_t capacity_, used_ = 0;
};

}  // namespace embed
