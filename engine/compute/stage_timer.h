#pragma once
#include <memory>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/timing.h>

namespace iclk::engine {

/// Measures the device time of each stage of one recording, which may be submitted many times. A stage lasts from
/// Recorder::stage() to the next such call, or to Recorder::finish(). Overlapping commands count for the stage in which they
/// end. On queues without timestamps every call does nothing and times() is empty.
class StageTimer {
 public:
  /// `max_stages`: the largest number of Recorder::stage() calls in one recording. Throws Error(out_of_memory).
  explicit StageTimer(std::shared_ptr<const Context> context, uint32_t max_stages = 1024);
  ~StageTimer();
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

  bool available() const { return pool_ != VK_NULL_HANDLE; }

  /// Adds the times of the last submission. Precondition: the submission has ended. Does nothing if nothing was recorded.
  void collect();
  /// Sums since construction or clear(), in the order in which each name first occurred.
  const std::vector<StageTime>& times() const { return times_; }
  void clear() { times_.clear(); }

 private:
  friend class Recorder;
  void begin(VkCommandBuffer commands);
  /// A null name ends the last stage. Throws Error(invalid_argument) beyond max_stages.
  void mark(VkCommandBuffer commands, const char* name);

  std::shared_ptr<const Context> context_;
  uint32_t capacity_ = 0;
  VkQueryPool pool_ = VK_NULL_HANDLE;
  std::vector<std::string> marks_;  // marks_[i] is the stage that begins at timestamp i; empty: none
  std::vector<StageTime> times_;
};

}  // namespace iclk::engine
