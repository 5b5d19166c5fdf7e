#pragma once
#include <atomic>
#include <string>

#include <vulkan/vulkan.h>

namespace embed {

/// What every Vulkan application has, iclk or not: an instance, a device with one queue, a command buffer, a fence. Plain
/// Vulkan on purpose: the functions of libvulkan, nothing of iclk but the question which device to take and what it must bring.
class Host {
 public:
  /// `device`: index, part of a name or UUID as `iclk devices` prints them; empty: the best one. `validate`: with
  /// VK_LAYER_KHRONOS_validation and synchronisation validation, whose messages go to standard error and are counted.
  /// Throws iclk::Error.
  Host(const std::string& device, bool validate);
  ~Host();
  Host(const Host&) = delete;
  Host& operator=(const Host&) = delete;

  /// The command buffer, in the recording state.
  VkCommandBuffer begin();
  /// Ends it, submits it once and waits.
  void submit_and_wait();

  /// Of a memory type among `bits` that has `properties`.
  uint32_t memory_type(uint32_t bits, VkMemoryPropertyFlags properties) const;
  int messages() const { return messages_; }

  VkInstance instance = VK_NULL_HANDLE;
  VkPhysicalDevice physical_device = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  uint32_t queue_family = 0;
  std::string device_name;
  bool cpu_unasked = false;  ///< there is no GPU, and nobody asked for a CPU device
  double ns_per_tick = 0;    ///< of timestamps; 0: the queue has none

 private:
  Host() = default;
  void create_instance(bool validate);
  void create_device();

  VkDebugUtilsMessengerEXT messenger_ = VK_NULL_HANDLE;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  VkCommandBuffer commands_ = VK_NULL_HANDLE;
  VkFence fence_ = VK_NULL_HANDLE;
  std::atomic<int> messages_ = 0;
};

}  // namespace embed
