#pragma once
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <iclk/engine/device_ranking.h>
#include <iclk/engine/requirements.h>
#include <iclk/engine/vulkan_functions.h>

namespace iclk::engine {

enum class MessageSeverity { info, warning, error };

struct ContextOptions {
  std::string device;  ///< request of choose_device(): empty, index, part of a name, UUID
  /// VK_LAYER_KHRONOS_validation with synchronization validation; Error(unsupported) where it is missing.
  bool validation = false;
  /// Receives what validation has to say. May be called from any thread that uses the context, one call at a time.
  std::function<void(MessageSeverity, const std::string&)> on_message;
  bool storage_reads = false;  ///< read storage buffers in place of texel buffers, though these are large enough
  /// s: the most that one submission may take (Context::longest_submission()).
  std::optional<double> longest_submission;
  /// Asked once, when the device is chosen, for Context::pipeline_cache_data() of an earlier run on it, so that pipelines need
  /// not be compiled again. Of another device or driver, or no cache at all: ignored. The driver reads it: take it from where
  /// you put it and nobody else writes.
  std::function<std::vector<uint8_t>(const DeviceInfo&)> pipeline_cache;
  /// false: as if the device had no subgroup operations (DeviceInfo::subgroup_operations = 0)
  bool subgroups = true;
};

/// Memory that is asked of the application in vkAllocateMemory's place.
struct MemoryRequest {
  VkMemoryRequirements requirements{};   ///< memoryTypeBits is one bit: the type that was chosen
  VkMemoryPropertyFlags properties = 0;  ///< of that type
  bool mapped = false;                   ///< MemoryBlock::mapped is needed
};

/// `requirements.size` bytes that buffers are bound to, and nobody else's. They may be part of a larger allocation.
struct MemoryBlock {
  VkDeviceMemory memory = VK_NULL_HANDLE;
  VkDeviceSize offset = 0;  ///< in `memory`, a multiple of requirements.alignment
  void* mapped = nullptr;   ///< host address of the block's first byte, where the request wants it
  void* handle = nullptr;   ///< the application's, VmaAllocation for one; given back as it is
};

/// A device that the application created and keeps. It must outlive the Context and meet requirements(); nothing here is
/// ever destroyed by us, and no other queue is touched. With vulkanMemoryModel enabled, vulkanMemoryModelDeviceScope must be
/// too.
struct HostDevice {
  VkInstance instance = VK_NULL_HANDLE;  ///< made with VkApplicationInfo::apiVersion >= 1.1
  VkPhysicalDevice physical_device = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;  ///< for blocking calls; of queue_family. Foreign recordings never touch it
  uint32_t queue_family = 0;       ///< with COMPUTE; graphics is not needed
  PFN_vkGetInstanceProcAddr get_instance_proc_addr = nullptr;  ///< null: libvulkan.so.1 is opened
  /// Called around every vkQueueSubmit on `queue`, if the application uses that queue from other threads. Both or neither;
  /// neither may call iclk, and unlock_queue may not throw.
  std::function<void()> lock_queue, unlock_queue;
  /// Used from many threads at once, so not made EXTERNALLY_SYNCHRONIZED. Null: the context makes its own.
  VkPipelineCache pipeline_cache = VK_NULL_HANDLE;
  /// Where all memory of this context comes from and goes to. Both or neither: vkAllocateMemory. Called from whichever thread
  /// makes or destroys an object of iclk. allocate_memory returns a block without `memory` where there is none; free_memory may
  /// not throw.
  std::function<MemoryBlock(const MemoryRequest&)> allocate_memory;
  std::function<void(const MemoryBlock&)> free_memory;
};

/// A value of a timeline semaphore: VK_KHR_timeline_semaphore, or its feature of Vulkan 1.2, enabled by the application.
struct TimelinePoint {
  VkSemaphore semaphore = VK_NULL_HANDLE;
  uint64_t value = 0;
};

/// What a submission waits for before its compute and transfer commands, and signals behind the last.
struct Synchronisation {
  std::span<const TimelinePoint> wait = {}, signal = {};
};

class Pipelines;

/// A device with one compute queue. Thread-safe. Kernels, workspaces and submissions hold a shared_ptr to it, so the order
/// in which they are destroyed does not matter. Nothing is shared between contexts.
class Context {
 public:
  ~Context();
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  const DeviceFunctions& vk() const { return vk_; }
  const InstanceFunctions& instance_functions() const { return instance_functions_; }
  VkInstance instance() const { return instance_; }
  VkPhysicalDevice physical_device() const { return physical_device_; }
  VkDevice device() const { return device_; }
  VkQueue queue() const { return queue_; }
  uint32_t queue_family() const { return queue_family_; }
  VkPipelineCache pipeline_cache() const { return pipeline_cache_; }
  /// What the pipeline cache holds now, for ContextOptions::pipeline_cache of a later run. Empty where the driver keeps
  /// nothing.
  std::vector<uint8_t> pipeline_cache_data() const;
  Pipelines& pipelines() const { return *pipelines_; }  ///< those of the kernels, internal/pipelines.h
  bool owns_device() const { return owns_device_; }

  const DeviceInfo& info() const { return info_; }
  const VkPhysicalDeviceLimits& limits() const { return limits_; }
  const VkPhysicalDeviceMemoryProperties& memory_properties() const { return memory_; }
  VkDeviceSize max_allocation() const { return max_allocation_; }  ///< bytes of one vkAllocateMemory
  /// Texel buffers of this device end below kLeastTexels: BindingKind::texel_read is storage_read here, buffers have no texel
  /// views, and limits().maxTexelBufferElements says that nothing ends there.
  bool storage_reads() const { return storage_reads_; }
  /// CPU or integrated, with memory that is both the device's and the host's: buffers of MemoryKind::device are mapped.
  bool unified_memory() const { return unified_memory_; }

  /// s: watchdogs of operating systems end what keeps a GPU for longer than about two. A Submission spreads what takes more.
  /// Infinite on CPU devices, which nobody watches.
  double longest_submission() const { return longest_submission_; }

  double timestamp_period() const { return limits_.timestampPeriod; }      ///< nanoseconds a tick
  uint32_t timestamp_valid_bits() const { return timestamp_valid_bits_; }  ///< 0: this queue has no timestamps

  /// A CPU device was taken although nobody asked for it: the application should say so, with info().name.
  bool cpu_unasked() const { return cpu_unasked_; }

  /// vkQueueSubmit of one command buffer under our mutex and the host's lock. Throws Error(device_lost), Error(out_of_memory).
  void submit(VkCommandBuffer commands, VkFence fence, const Synchronisation& synchronisation = {}) const;

  /// Memory of the application where it brings an allocator, else of vkAllocateMemory. Throws Error(out_of_memory) with
  /// `details`; Error(invalid_argument) for a block of the application that does not fit the request.
  MemoryBlock allocate(const MemoryRequest& request, const std::string& details) const;
  void free(const MemoryBlock& block) const noexcept;

  /// Gives an object the name by which validation and debuggers call it. Does nothing without validation.
  void name_object(VkObjectType type, uint64_t handle, const std::string& name) const;

 private:
  friend struct ContextBuilder;
  Context();

  std::shared_ptr<void> keep_alive_;  // our instance, or the loader of an adopted one; outlives the device
  InstanceFunctions instance_functions_;
  DeviceFunctions vk_;
  VkInstance instance_ = VK_NULL_HANDLE;
  VkPhysicalDevice physical_device_ = VK_NULL_HANDLE;
  VkDevice device_ = VK_NULL_HANDLE;
  VkQueue queue_ = VK_NULL_HANDLE;
  uint32_t queue_family_ = 0, timestamp_valid_bits_ = 0;
  VkPipelineCache pipeline_cache_ = VK_NULL_HANDLE;
  std::unique_ptr<Pipelines> pipelines_;
  bool owns_device_ = false, owns_pipeline_cache_ = false, cpu_unasked_ = false, storage_reads_ = false,
       unified_memory_ = false;
  DeviceInfo info_;
  VkPhysicalDeviceLimits limits_{};
  VkPhysicalDeviceMemoryProperties memory_{};
  VkDeviceSize max_allocation_ = 0;
  double longest_submission_ = 0;
  mutable std::mutex queue_mutex_;
  std::function<void()> lock_queue_, unlock_queue_;
  std::function<MemoryBlock(const MemoryRequest&)> allocate_memory_;
  std::function<void(const MemoryBlock&)> free_memory_;
  PFN_vkSetDebugUtilsObjectNameEXT set_name_ = nullptr;
};

/// Every Vulkan device of this machine, usable or not (DeviceInfo::rejected). The index is the one that ContextOptions::device
/// takes. Throws Error(no_driver) without a Vulkan loader or driver; an empty list when drivers find no device.
std::vector<DeviceInfo> list_devices();

/// Chooses a device and creates it, with one queue: compute without graphics where there is such a family.
/// Throws Error(no_driver), Error(no_device), Error(unsupported: validation layer), Error(vulkan).
std::shared_ptr<Context> create_context(const ContextOptions& options = {});

/// Takes a device of the application. Throws Error(invalid_argument) for a null handle, one lock callback without the other, a
/// queue family that does not exist or cannot compute; Error(unsupported) with what requirements() misses.
std::shared_ptr<Context> adopt_device(const HostDevice& host);

}  // namespace iclk::engine
