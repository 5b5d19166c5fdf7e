#include <iclk/engine/submission.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

constexpr int kWaitAttempts = 10;
constexpr uint64_t kNoLimit = std::numeric_limits<uint64_t>::max();
/// The first value, before any measurement. The slowest GPUs run this many workgroups of a convolution in time.
constexpr uint64_t kFirstGroups = 2048;
constexpr uint64_t kFewestGroups = 16;
/// The largest factors by which the number may change after a submission, because kernels differ even more than devices.
constexpr uint64_t kGrowth = 4, kShrinkage = 8;

}  // namespace

Submission::Submission(std::shared_ptr<const Context> context)
    : context_(std::move(context)), most_groups_(std::isfinite(context_->longest_submission()) ? kFirstGroups : kNoLimit) {
  const DeviceFunctions& vk = context_->vk();
  try {
    const VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr, 0, context_->queue_family()};
    check_made(vk.CreateCommandPool(context_->device(), &pool, nullptr, &pool_), pool_, "vkCreateCommandPool");
    add_part();
  } catch (...) {
    destroy();
    throw;
  }
}

Submission::~Submission() { destroy(); }

void Submission::add_part() {
  const DeviceFunctions& vk = context_->vk();
  const VkDevice device = context_->device();
  Part& part = parts_.emplace_back();
  try {
    const VkCommandBufferAllocateInfo buffer{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr, pool_,
                                             VK_COMMAND_BUFFER_LEVEL_PRIMARY, 1};
    check(vk.AllocateCommandBuffers(device, &buffer, &part.commands), "vkAllocateCommandBuffers");
    const VkFenceCreateInfo fence{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO, nullptr, 0};
    check_made(vk.CreateFence(device, &fence, nullptr, &part.fence), part.fence, "vkCreateFence");
  } catch (...) {
    parts_.pop_back();  // the pool keeps the command buffer
    throw;
  }
}

void Submission::destroy() noexcept {
  const DeviceFunctions& vk = context_->vk();
  const VkDevice device = context_->device();
  for (; first_pending_ < end_pending_; ++first_pending_)
    wait_for(parts_[first_pending_].fence);  // a lost device returns at once and may be destroyed
  for (const Part& part : parts_) vk.DestroyFence(device, part.fence, nullptr);
  if (pool_) vk.DestroyCommandPool(device, pool_, nullptr);
}

VkCommandBuffer Submission::begin() {
  wait();
  check(context_->vk().ResetCommandPool(context_->device(), pool_, 0), "vkResetCommandPool");
  recorded_ = 0;
  return begin_part();
}

VkCommandBuffer Submission::begin_part() {
  if (recorded_ == parts_.size()) add_part();
  const VkCommandBuffer commands = parts_[recorded_].commands;
  const VkCommandBufferBeginInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  check(context_->vk().BeginCommandBuffer(commands, &info), "vkBeginCommandBuffer");
  ++recorded_;
  return commands;
}

VkCommandBuffer Submission::next() {
  end();
  return begin_part();
}

void Submission::end() { check(context_->vk().EndCommandBuffer(parts_[recorded_ - 1].commands), "vkEndCommandBuffer"); }

void Submission::submit(const Synchronisation& synchronisation) {
  wait();
  first_pending_ = end_pending_ = 0;
  longest_ = 0;
  submitted_ = std::chrono::steady_clock::now();
  for (; end_pending_ < recorded_; ++end_pending_) {
    const Part& part = parts_[end_pending_];
    check(context_->vk().ResetFences(context_->device(), 1, &part.fence), "vkResetFences");
    // Each part gets all semaphores: without a barrier, a later part does not wait for the semaphores of an earlier one.
    const bool last = end_pending_ + 1 == recorded_;
    context_->submit(part.commands, part.fence,
                     {synchronisation.wait, last ? synchronisation.signal : std::span<const TimelinePoint>{}});
  }
}

bool Submission::finished() const {
  if (first_pending_ == end_pending_) return true;
  const VkFence last = parts_[end_pending_ - 1].fence;
  const VkResult result = context_->vk().WaitForFences(context_->device(), 1, &last, VK_TRUE, 0);
  check(result, "vkWaitForFences", context_->info().name);
  return result == VK_SUCCESS;
}

void Submission::wait() {
  if (first_pending_ == end_pending_) return;
  for (; first_pending_ < end_pending_; ++first_pending_) {
    const VkResult result = wait_for(parts_[first_pending_].fence);
    if (result == VK_ERROR_DEVICE_LOST) first_pending_ = end_pending_;
    check(result, "vkWaitForFences", context_->info().name);
    const auto now = std::chrono::steady_clock::now();
    longest_ = std::max(longest_, std::chrono::duration<double>(now - submitted_).count());
    submitted_ = now;
  }
  adapt(longest_);
}

/// If the host waits late, the device seems slow. Parts then become smaller than necessary, and later larger again.
void Submission::adapt(double seconds) {
  const double limit = context_->longest_submission();
  if (!std::isfinite(limit)) return;
  if (seconds > limit)
    most_groups_ = std::max(kFewestGroups, most_groups_ / kShrinkage);
  else if (seconds < limit / (2 * kGrowth) && most_groups_ < kNoLimit / kGrowth)
    most_groups_ *= kGrowth;
}

VkResult Submission::wait_for(VkFence fence) noexcept {
  // If there is no memory for waiting, the device still runs, and its resources must stay.
  VkResult result = VK_SUCCESS;
  for (int attempt = 0; attempt < kWaitAttempts; ++attempt) {
    result = context_->vk().WaitForFences(context_->device(), 1, &fence, VK_TRUE, UINT64_MAX);
    if (result >= 0 || result == VK_ERROR_DEVICE_LOST) break;
  }
  return result;
}

}  // namespace iclk::engine
