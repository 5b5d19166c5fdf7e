#pragma once
#include <chrono>
#include <memory>
#include <vector>

#include <iclk/engine/context.h>

namespace iclk::engine {

/// Command buffers of iclk: recorded once, submitted any number of times. Where Context::longest_submission() is finite, the
/// commands are split over several command buffers that are submitted in sequence, so that each one stays below that limit.
/// One thread at a time; different submissions may be used from different threads.
class Submission {
 public:
  explicit Submission(std::shared_ptr<const Context> context);
  ~Submission();  ///< waits for pending work
  Submission(const Submission&) = delete;
  Submission& operator=(const Submission&) = delete;

  /// Waits for pending work, discards the old commands and starts recording.
  VkCommandBuffer begin();
  /// Continues in another command buffer, which is executed after the previous one. Precondition: recording.
  VkCommandBuffer next();
  /// Ends recording.
  void end();

  /// The largest number of workgroups that one command buffer should have. It is adapted to the times of earlier submissions;
  /// its first value is small.
  uint64_t most_groups() const { return most_groups_; }

  /// Submits the commands after waiting for the previous submission. Precondition: end() was called. The semaphores in
  /// `synchronisation` must live until this submission has ended. Throws Error(device_lost), Error(out_of_memory).
  void submit(const Synchronisation& synchronisation = {});
  /// Whether wait() would return at once. Throws Error(device_lost), Error(out_of_memory).
  bool finished() const;
  /// Waits for the last submission; returns at once if nothing is pending. There is no timeout, because kernels may be slow on
  /// a CPU. Throws Error(device_lost). Throws Error(out_of_memory) after several attempts; then the submission is still
  /// pending.
  void wait();
  void submit_and_wait() {
    submit();
    wait();
  }

  const std::shared_ptr<const Context>& context() const { return context_; }

 private:
  struct Part {
    VkCommandBuffer commands = VK_NULL_HANDLE;
    VkFence fence = VK_NULL_HANDLE;
  };
  void add_part();
  VkCommandBuffer begin_part();
  void destroy() noexcept;
  VkResult wait_for(VkFence fence) noexcept;
  void adapt(double seconds);

  std::shared_ptr<const Context> context_;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  std::vector<Part> parts_;  // reused by the next recording
  size_t recorded_ = 0;      // the number of parts_ in use
  size_t first_pending_ = 0, end_pending_ = 0;
  std::chrono::steady_clock::time_point submitted_;
  double longest_ = 0;  // s, the longest time of a part of this submission that has ended
  uint64_t most_groups_;
};

}  // namespace iclk::engine
