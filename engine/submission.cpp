#include <iclk/engine/submission.h>

#include <utility>

#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

constexpr int kWaitAttempts = 10;

}  // namespace

Submission::Submission(std::shared_ptr<const Context> context) : context_(std::move(context)) {
  const DeviceFunctions& vk = context_->vk();
  const VkDevice device = context_->device();
  try {
    const VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr, 0, context_->queue_family()};
    check_made(vk.CreateCommandPool(device, &pool, nullptr, &pool_), pool_, "vkCreateCommandPool");
    const VkCommandBufferAllocateInfo buffer{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr, pool_,
                                             VK_COMMAND_BUFFER_LEVEL_PRIMARY, 1};
    check(vk.AllocateCommandBuffers(device, &buffer, &commands_), "vkAllocateCommandBuffers");
    const VkFenceCreateInfo fence{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO, nullptr, 0};
    check_made(vk.CreateFence(device, &fence, nullptr, &fence_), fence_, "vkCreateFence");
  } catch (...) {
    destroy();
    throw;
  }
}

Submission::~Submission() { destroy(); }

void Submission::destroy() noexcept {
  const DeviceFunctions& vk = context_->vk();
  const VkDevice device = context_->device();
  if (pending_) wait_for_fence();  // a lost device returns at once and may be destroyed
  if (fence_) vk.DestroyFence(device, fence_, nullptr);
  if (pool_) vk.DestroyCommandPool(device, pool_, nullptr);
}

VkCommandBuffer Submission::begin() {
  wait();
  check(context_->vk().ResetCommandPool(context_->device(), pool_, 0), "vkResetCommandPool");
  const VkCommandBufferBeginInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  check(context_->vk().BeginCommandBuffer(commands_, &info), "vkBeginCommandBuffer");
  return commands_;
}

void Submission::end() { check(context_->vk().EndCommandBuffer(commands_), "vkEndCommandBuffer"); }

void Submission::submit() {
  wait();
  check(context_->vk().ResetFences(context_->device(), 1, &fence_), "vkResetFences");
  context_->submit(commands_, fence_);
  pending_ = true;
}

void Submission::wait() {
  if (!pending_) return;
  const VkResult result = wait_for_fence();
  pending_ = result < 0 && result != VK_ERROR_DEVICE_LOST;
  check(result, "vkWaitForFences", context_->info().name);
}

VkResult Submission::wait_for_fence() noexcept {
  // Where memory for waiting runs out the device works on, and what it works on must stay.
  VkResult result = VK_SUCCESS;
  for (int attempt = 0; attempt < kWaitAttempts; ++attempt) {
    result = context_->vk().WaitForFences(context_->device(), 1, &fence_, VK_TRUE, UINT64_MAX);
    if (result >= 0 || result == VK_ERROR_DEVICE_LOST) break;
  }
  return result;
}

}  // namespace iclk::engine
