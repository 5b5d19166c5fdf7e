#pragma once
#include <chrono>
#include <memory>
#include <vector>

#include <iclk/engine/context.h>

namespace iclk::engine {

/// Commands of our own: recorded once, submitted as often as wanted. On a device that is watched they are spread over several
/// command buffers, submitted one behind the other, none of which is meant to take longer than Context::longest_submission().
/// One thread at a time; any number of submissions may be used from any number of threads.
class Submission {
 public:
  explicit Submission(std::shared_ptr<const Context> context);
  ~Submission();  ///< waits for what is pending
  Submission(const Submission&) = delete;
  Submission& operator=(const Submission&) = delete;

  /// Waits for what is pending, forgets the old commands and starts recording.
  VkCommandBuffer begin();
  /// Precondition: recording. Goes on in another command buffer, which is executed after the one before.
  VkCommandBuffer next();
  /// Ends recording.
  void end();

  /// Workgroups that a command buffer should hold at most. It follows the time that earlier submissions took; so the first are
  /// cut small.
  uint64_t most_groups() const { return most_groups_; }

  /// Precondition: end() was called. Waits for the submission before this one. What `synchronisation` names must stay until
  /// this one has ended. Throws Error(device_lost), Error(out_of_memory).
  void submit(const Synchronisation& synchronisation = {});
  /// Whether wait() would return at once. Throws Error(device_lost), Error(out_of_memory).
  bool finished() const;
  /// Returns at once when nothing is pending. No timeout: kernels may be slow on a CPU. Throws Error(device_lost);
  /// Error(out_of_memory), which several attempts did not get over: then the submission is still pending.
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
  std::vector<Part> parts_;  // kept from recording to recording
  size_t recorded_ = 0;      // of parts_
  size_t first_pending_ = 0, end_pending_ = 0;
  std::chrono::steady_clock::time_point submitted_;
  double longest_ = 0;  // s, of the parts of this submission that have ended
  uint64_t most_groups_;
};

}  // namespace iclk::engine
