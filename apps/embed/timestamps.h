#pragma once
#include <vector>

#include "apps/embed/host.h"

namespace embed {

/// Timestamps in the application's command buffer. Does nothing where the queue has none.
class Timestamps {
 public:
  Timestamps(Host& host, uint32_t stamps);
  ~Timestamps();
  Timestamps(const Timestamps&) = delete;
  Timestamps& operator=(const Timestamps&) = delete;

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
