#pragma once
#include <memory>

#include <iclk/engine/context.h>

namespace iclk::engine {

/// A command buffer of our own with its pool and fence: recorded once, submitted as often as wanted. One thread at a time; any
/// number of submissions may be used from any number of threads.
class Submission {
 public:
  explicit Submission(std::shared_ptr<const Context> context);
  ~Submission();  ///< waits for what is pending
  Submission(const Submission&) = delete;
  Submission& operator=(const Submission&) = delete;

  /// Waits for what is pending, forgets the old commands and starts recording.
  VkCommandBuffer begin();
  /// Ends recording.
  void end();

  /// Precondition: end() was called. Waits for the submission before this one. Throws Error(device_lost), Error(out_of_memory).
  void submit();
  /// Returns at once when nothing is pending. No timeout: kernels may be slow on a CPU. Throws Error(device_lost);
  /// Error(out_of_memory), which several attempts did not get over: then the submission is still pending.
  void wait();
  void submit_and_wait() {
    submit();
    wait();
  }

 private:
  void destroy() noexcept;
  VkResult wait_for_fence() noexcept;

  std::shared_ptr<const Context> context_;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  VkCommandBuffer commands_ = VK_NULL_HANDLE;
  VkFence fence_ = VK_NULL_HANDLE;
  bool pending_ = false;
};

}  // namespace iclk::engine
