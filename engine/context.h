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
  std::string device;  ///< the `request` of choose_device(): empty, an index, a UUID or part of a name
  /// Enables VK_LAYER_KHRONOS_validation with synchronization validation; Error(unsupported) if it is missing.
  bool validation = false;
  /// Receives the validation messages. Any thread that uses the context may call it, one call at a time.
  std::function<void(MessageSeverity, const std::string&)> on_message;
  bool storage_reads = false;  ///< use storage buffers instead of texel buffers even if these are large enough
  /// The longest time of one submission in s (Context::longest_submission()).
  std::optional<double> longest_submission;
  /// Returns saved Context::pipeline_cache_data() of this device, so that its pipelines need no compilation. Called once, when
  /// the device is chosen. Data of another device or driver and invalid data are ignored. The driver parses the data: load it
  /// only from files that nobody else can write.
  std::function<std::vector<uint8_t>(const DeviceInfo&)> pipeline_cache;
  /// false: do not use subgroup operations (DeviceInfo::subgroup_operations = 0)
  bool subgroups = true;
};

/// A request for memory to the application, instead of vkAllocateMemory.
struct MemoryRequest {
  VkMemoryRequirements requirements{};   ///< memoryTypeBits has one bit: the chosen type
  VkMemoryPropertyFlags properties = 0;  ///< of that type
  bool mapped = false;                   ///< MemoryBlock::mapped is needed
};

/// `requirements.size` bytes for the buffers of iclk only. They may be part of a larger allocation.
struct MemoryBlock {
  VkDeviceMemory memory = VK_NULL_HANDLE;
  VkDeviceSize offset = 0;  ///< in `memory`, a multiple of requirements.alignment
  void* mapped = nullptr;   ///< host address of the first byte of the block, if requested
  void* handle = nullptr;   ///< for the application (a VmaAllocation, for example); returned to free_memory unchanged
};

/// A device of the application. It must outlive the Context and meet requirements(). iclk destroys none of these objects and
/// uses no other queue. If vulkanMemoryModel is enabled, vulkanMemoryModelDeviceScope must be enabled too.
struct HostDevice {
  VkInstance instance = VK_NULL_HANDLE;  ///< made with VkApplicationInfo::apiVersion >= 1.1
  VkPhysicalDevice physical_device = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  /// Of queue_family; used by blocking calls. Recordings into command buffers of the application never use it.
  VkQueue queue = VK_NULL_HANDLE;
  uint32_t queue_family = 0;                                   ///< with COMPUTE; graphics is not needed
  PFN_vkGetInstanceProcAddr get_instance_proc_addr = nullptr;  ///< null: iclk opens libvulkan.so.1
  /// Called around every vkQueueSubmit on `queue`, for applications that use this queue from other threads. Set both or
  /// neither. Neither may call iclk, and unlock_queue must not throw.
  std::function<void()> lock_queue, unlock_queue;
  /// Many threads use it at once, so it must not be EXTERNALLY_SYNCHRONIZED. Null: the context makes its own.
  VkPipelineCache pipeline_cache = VK_NULL_HANDLE;
  /// Allocate and free all device memory of this context. Set both, or neither: then iclk calls vkAllocateMemory. Any thread
  /// that makes or destroys an object of iclk may call them. If there is no memory, allocate_memory returns a block whose
  /// `memory` is null. free_memory must not throw.
  std::function<MemoryBlock(const MemoryRequest&)> allocate_memory;
  std::function<void(const MemoryBlock&)> free_memory;
};

/// A value of a timeline semaphore. The application must enable VK_KHR_timeline_semaphore or its feature of Vulkan 1.2.
struct TimelinePoint {
  VkSemaphore semaphore = VK_NULL_HANDLE;
  uint64_t value = 0;
};

/// A submission waits for `wait` before its compute and transfer commands, and signals `signal` after the last one.
struct Synchronisation {
  std::span<const TimelinePoint> wait = {}, signal = {};
};

class Pipelines;

/// A device with one compute queue. Thread-safe. Kernels, workspaces and submissions have a shared_ptr to their context, so
/// they may be destroyed in any order. Contexts share nothing.
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
  /// The current contents of the pipeline cache, for ContextOptions::pipeline_cache of a later run. Empty if the driver caches
  /// nothing.
  std::vector<uint8_t> pipeline_cache_data() const;
  Pipelines& pipelines() const { return *pipelines_; }  ///< of all kernels: compute/pipelines.h
  bool owns_device() const { return owns_device_; }

  const DeviceInfo& info() const { return info_; }
  const VkPhysicalDeviceLimits& limits() const { return limits_; }
  const VkPhysicalDeviceMemoryProperties& memory_properties() const { return memory_; }
  VkDeviceSize max_allocation() const { return max_allocation_; }  ///< bytes of one vkAllocateMemory
  /// Kernels use storage buffers instead of texel buffers, because the texel buffers of this device are smaller than
  /// kLeastTexels. Then BindingKind::texel_read is storage_read, buffers have no texel views, and
  /// limits().maxTexelBufferElements is the largest uint32_t.
  bool storage_reads() const { return storage_reads_; }
  /// A CPU or integrated device with memory that is device local and visible to the host: buffers of MemoryKind::device are
  /// mapped.
  bool unified_memory() const { return unified_memory_; }

  /// The longest time of one submission in s. Operating systems stop work that occupies a GPU for more than about 2 s, so a
  /// Submission splits longer work. Infinite on CPU devices, which have no such watchdog.
  double longest_submission() const { return longest_submission_; }

  double timestamp_period() const { return limits_.timestampPeriod; }      ///< nanoseconds per tick
  uint32_t timestamp_valid_bits() const { return timestamp_valid_bits_; }  ///< 0: this queue has no timestamps

  /// A CPU device was chosen although ContextOptions::device did not name it. The application should report it, with
  /// info().name.
  bool cpu_unasked() const { return cpu_unasked_; }

  /// Submits one command buffer under the mutex of the context and HostDevice::lock_queue. Throws Error(device_lost),
  /// Error(out_of_memory).
  void submit(VkCommandBuffer commands, VkFence fence, const Synchronisation& synchronisation = {}) const;

  /// Allocates memory from HostDevice::allocate_memory if it is set, else from vkAllocateMemory. Throws Error(out_of_memory)
  /// with `details`; Error(invalid_argument) if the block of the application does not fit the request.
  MemoryBlock allocate(const MemoryRequest& request, const std::string& details) const;
  void free(const MemoryBlock& block) const noexcept;

  /// Names an object for validation messages and debuggers. Does nothing without validation.
  void name_object(VkObjectType type, uint64_t handle, const std::string& name) const;

 private:
  friend struct ContextBuilder;
  Context();

  std::shared_ptr<void> keep_alive_;  // the instance of iclk, or the loader for an adopted one; outlives the device
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

/// Lists all Vulkan devices of this machine, usable or not (DeviceInfo::rejected). ContextOptions::device accepts their
/// indices. The list is empty if drivers find no device. Throws Error(no_driver) without a Vulkan loader or driver.
std::vector<DeviceInfo> list_devices();

/// Chooses a device and creates it with one queue, from a family with compute but no graphics if there is one.
/// Throws Error(no_driver); Error(no_device); Error(unsupported) for a missing validation layer; Error(vulkan).
std::shared_ptr<Context> create_context(const ContextOptions& options = {});

/// Makes a context for a device of the application. Throws Error(invalid_argument) for a null handle, one callback of a pair
/// without the other, and a queue family that does not exist or cannot compute. Throws Error(unsupported) with the unmet
/// requirements().
std::shared_ptr<Context> adopt_device(const HostDevice& host);

}  // namespace iclk::engine
