#include "faults.h"

#include <algorithm>
#include <stdexcept>

namespace iclk::test {
namespace {

/// Error codes of vk.xml 1.3.239, without those of extensions and of requests that iclk does not make (a layer or an extension
/// by name, imported memory).
std::vector<LayerCall> all_calls() {
  constexpr VkResult host = VK_ERROR_OUT_OF_HOST_MEMORY, device = VK_ERROR_OUT_OF_DEVICE_MEMORY, lost = VK_ERROR_DEVICE_LOST,
                     start = VK_ERROR_INITIALIZATION_FAILED;
  return {{"vkCreateInstance", {host, device, start, VK_ERROR_INCOMPATIBLE_DRIVER}},
          {"vkCreateDebugUtilsMessengerEXT", {host}},
          {"vkEnumeratePhysicalDevices", {host, device, start}},
          {"vkEnumerateDeviceExtensionProperties", {host, device}},
          {"vkCreateDevice", {host, device, start, VK_ERROR_TOO_MANY_OBJECTS, lost}},
          {"vkDeviceWaitIdle", {host, device, lost}},
          {"vkQueueSubmit", {host, device, lost}},
          {"vkAllocateMemory", {host, device}},
          {"vkMapMemory", {host, device, VK_ERROR_MEMORY_MAP_FAILED}},
          {"vkBindBufferMemory", {host, device}},
          {"vkCreateBuffer", {host, device}},
          {"vkCreateBufferView", {host, device}},
          {"vkCreateShaderModule", {host, device}},
          {"vkCreatePipelineCache", {host, device}},
          {"vkGetPipelineCacheData", {host, device}},
          {"vkCreateComputePipelines", {host, device}},
          {"vkCreatePipelineLayout", {host, device}},
          {"vkCreateDescriptorSetLayout", {host, device}},
          {"vkCreateDescriptorPool", {host, device}},
          {"vkAllocateDescriptorSets", {host, device, VK_ERROR_FRAGMENTED_POOL, VK_ERROR_OUT_OF_POOL_MEMORY}},
          {"vkCreateCommandPool", {host, device}},
          {"vkResetCommandPool", {device}},
          {"vkAllocateCommandBuffers", {host, device}},
          {"vkBeginCommandBuffer", {host, device}},
          {"vkEndCommandBuffer", {host, device}},
          {"vkCreateFence", {host, device}},
          {"vkResetFences", {device}},
          {"vkWaitForFences", {host, device, lost}},
          {"vkCreateQueryPool", {host, device}},
          {"vkGetQueryPoolResults", {host, device, lost}}};
}

}  // namespace

Faults::Faults() : calls_(all_calls()), counts_(calls_.size()), armed_(calls_.size()) {}

size_t Faults::index(const std::string& call) const {
  const auto found = std::find_if(calls_.begin(), calls_.end(), [&](const LayerCall& c) { return c.name == call; });
  if (found == calls_.end()) throw std::logic_error("the test layer does not know " + call);
  return static_cast<size_t>(found - calls_.begin());
}

void Faults::arm(size_t call, uint32_t ordinal, VkResult result, uint32_t times) {
  const std::lock_guard lock(mutex_);
  counts_.assign(calls_.size(), 0);
  armed_ = call;
  ordinal_ = ordinal;
  times_ = times;
  result_ = result;
  fired_ = false;
}

void Faults::disarm() { arm(calls_.size(), 0, VK_SUCCESS, 0); }

bool Faults::fired() const {
  const std::lock_guard lock(mutex_);
  return fired_;
}

uint32_t Faults::count(size_t call) const {
  const std::lock_guard lock(mutex_);
  return counts_[call];
}

std::optional<VkResult> Faults::next(size_t call) {
  const std::lock_guard lock(mutex_);
  const uint32_t at = counts_[call]++;
  if (call != armed_ || at < ordinal_ || at - ordinal_ >= times_) return {};
  fired_ = true;
  return result_;
}

bool Faults::may_lose_device(size_t call) const {
  const auto& results = calls_[call].results;
  return std::find(results.begin(), results.end(), VK_ERROR_DEVICE_LOST) != results.end();
}

}  // namespace iclk::test
