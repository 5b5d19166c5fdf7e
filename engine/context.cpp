#include <iclk/engine/context.h>

#include <bit>
#include <cstring>
#include <limits>

#include <iclk/engine/compute/memory_layout.h>
#include <iclk/engine/compute/pipelines.h>
#include <iclk/engine/internal/instance.h>
#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

/// A quarter of the limit of Windows, which is the shortest.
constexpr double kLongestSubmission = 0.5;

/// Holds the lock of the application; releases it on every return and throw.
class HostLock {
 public:
  HostLock(const std::function<void()>& lock, const std::function<void()>& unlock) : unlock_(unlock) {
    if (lock) lock();
  }
  ~HostLock() {
    if (unlock_) unlock_();
  }
  HostLock(const HostLock&) = delete;
  HostLock& operator=(const HostLock&) = delete;

 private:
  const std::function<void()>& unlock_;
};

/// Timeline points in the form of Vulkan.
struct Semaphores {
  explicit Semaphores(std::span<const TimelinePoint> points) {
    for (const TimelinePoint& point : points) {
      handles.push_back(point.semaphore);
      values.push_back(point.value);
    }
  }
  uint32_t count() const { return static_cast<uint32_t>(handles.size()); }
  std::vector<VkSemaphore> handles;
  std::vector<uint64_t> values;
};

/// Whether these bytes begin with the header of a cache of this driver and device. Drivers differ in their treatment of other
/// caches.
bool is_cache_of(const Context& context, const std::vector<uint8_t>& bytes) {
  VkPhysicalDeviceProperties device;
  context.instance_functions().GetPhysicalDeviceProperties(context.physical_device(), &device);
  struct {
    uint32_t size, version, vendor, device;
    uint8_t uuid[VK_UUID_SIZE];
  } header;
  static_assert(sizeof(header) == 32);
  if (bytes.size() < sizeof(header)) return false;
  std::memcpy(&header, bytes.data(), sizeof(header));
  return header.size == sizeof(header) && header.version == VK_PIPELINE_CACHE_HEADER_VERSION_ONE &&
         header.vendor == device.vendorID && header.device == device.deviceID &&
         std::memcmp(header.uuid, device.pipelineCacheUUID, VK_UUID_SIZE) == 0;
}

}  // namespace

struct ContextBuilder {
  static std::shared_ptr<Context> make() { return std::shared_ptr<Context>(new Context); }

  /// Sets all fields that follow from the physical device and the queue family.
  static void describe(Context& c, const DeviceCapabilities& capabilities, bool storage_reads) {
    const InstanceFunctions& vk = c.instance_functions_;
    c.info_ = info_of(vk, c.physical_device_, capabilities);
    c.limits_ = capabilities.limits;
    c.longest_submission_ = c.info_.type == DeviceType::cpu ? std::numeric_limits<double>::infinity() : kLongestSubmission;
    c.storage_reads_ = storage_reads || c.limits_.maxTexelBufferElements < kLeastTexels;
    if (c.storage_reads_) c.limits_.maxTexelBufferElements = std::numeric_limits<uint32_t>::max();
    c.timestamp_valid_bits_ = capabilities.queue_families[c.queue_family_].timestampValidBits;
    vk.GetPhysicalDeviceMemoryProperties(c.physical_device_, &c.memory_);
    const bool beside_the_cpu = c.info_.type == DeviceType::cpu || c.info_.type == DeviceType::integrated;
    c.unified_memory_ = beside_the_cpu && has_shared_type(c.memory_);
    VkPhysicalDeviceMaintenance3Properties maintenance{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_3_PROPERTIES};
    VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &maintenance};
    vk.GetPhysicalDeviceProperties2(c.physical_device_, &properties);
    c.max_allocation_ = maintenance.maxMemoryAllocationSize;
  }

  static void make_pipeline_cache(Context& c, const std::vector<uint8_t>& kept) {
    VkPipelineCacheCreateInfo info{VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO};
    if (is_cache_of(c, kept)) {
      info.initialDataSize = kept.size();
      info.pInitialData = kept.data();
    }
    check(c.vk_.CreatePipelineCache(c.device_, &info, nullptr, &c.pipeline_cache_), "vkCreatePipelineCache");
    c.owns_pipeline_cache_ = true;
  }

  static std::shared_ptr<Context> create(const ContextOptions& options);
  static std::shared_ptr<Context> adopt(const HostDevice& host);
};

std::shared_ptr<Context> ContextBuilder::create(const ContextOptions& options) {
  const auto instance = std::make_shared<Instance>(options.validation, options.on_message);
  const InstanceFunctions& vk = instance->functions();
  const std::vector<VkPhysicalDevice> devices = instance->physical_devices();
  std::vector<DeviceCapabilities> capabilities;
  std::vector<DeviceInfo> infos;
  for (VkPhysicalDevice device : devices) {
    capabilities.push_back(capabilities_of(vk, device));
    infos.push_back(info_of(vk, device, capabilities.back()));
  }
  const DeviceChoice choice = choose_device(infos, options.device);

  const auto context = make();
  Context& c = *context;
  c.keep_alive_ = instance;
  c.instance_functions_ = vk;
  c.instance_ = instance->handle();
  c.physical_device_ = devices[choice.index];
  c.cpu_unasked_ = choice.cpu_unasked;
  const DeviceRequirements needed = requirements();
  c.queue_family_ = static_cast<uint32_t>(choose_queue_family(capabilities[choice.index].queue_families, needed.queue_flags));

  const float priority = 1.0f;
  VkDeviceQueueCreateInfo queue{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
  queue.queueFamilyIndex = c.queue_family_;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  const std::vector<std::string> enabled = extensions_to_enable(needed, capabilities[choice.index]);
  std::vector<const char*> extensions;
  for (const std::string& extension : enabled) extensions.push_back(extension.c_str());
  VkDeviceCreateInfo info{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  info.ppEnabledExtensionNames = extensions.data();
  info.pEnabledFeatures = &needed.features;
  VkDevice device = VK_NULL_HANDLE;
  check(vk.CreateDevice(c.physical_device_, &info, nullptr, &device), "vkCreateDevice",
        infos[choice.index].name + "; choose another device: " + engine::describe(infos));
  try {
    c.vk_ = load_device_functions(vk.GetDeviceProcAddr, device);
  } catch (...) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyDevice>(vk.GetDeviceProcAddr(device, "vkDestroyDevice"));
    if (destroy) destroy(device, nullptr);
    throw;
  }
  c.device_ = device;
  c.owns_device_ = true;
  c.vk_.GetDeviceQueue(device, c.queue_family_, 0, &c.queue_);
  describe(c, capabilities[choice.index], options.storage_reads);
  if (options.longest_submission) c.longest_submission_ = *options.longest_submission;
  if (!options.subgroups) c.info_.subgroup_operations = 0;
  make_pipeline_cache(c, options.pipeline_cache ? options.pipeline_cache(c.info_) : std::vector<uint8_t>());
  if (instance->validation())
    c.set_name_ = reinterpret_cast<PFN_vkSetDebugUtilsObjectNameEXT>(
        instance->get_instance_proc_addr()(c.instance_, "vkSetDebugUtilsObjectNameEXT"));
  return context;
}

std::shared_ptr<Context> ContextBuilder::adopt(const HostDevice& host) {
  const auto reject = [](const std::string& why) { throw Error(ErrorCode::invalid_argument, "HostDevice: " + why); };
  if (!host.instance) reject("instance is null");
  if (!host.physical_device) reject("physical_device is null");
  if (!host.device) reject("device is null");
  if (!host.queue) reject("queue is null");
  if (static_cast<bool>(host.lock_queue) != static_cast<bool>(host.unlock_queue))
    reject("lock_queue and unlock_queue must be given together");
  if (static_cast<bool>(host.allocate_memory) != static_cast<bool>(host.free_memory))
    reject("allocate_memory and free_memory must be given together");

  const auto context = make();
  Context& c = *context;
  PFN_vkGetInstanceProcAddr get = host.get_instance_proc_addr;
  if (!get) {
    const auto loader = std::make_shared<Loader>();
    c.keep_alive_ = loader;
    get = loader->get_instance_proc_addr();
  }
  c.instance_functions_ = load_instance_functions(get, host.instance);
  const DeviceCapabilities capabilities = capabilities_of(c.instance_functions_, host.physical_device);
  const auto& families = capabilities.queue_families;
  if (host.queue_family >= families.size())
    reject("queue_family " + std::to_string(host.queue_family) + " does not exist; the device has " +
           std::to_string(families.size()));
  if (!(families[host.queue_family].queueFlags & VK_QUEUE_COMPUTE_BIT))
    reject("queue_family " + std::to_string(host.queue_family) + " has no COMPUTE; see requirements().queue_flags");
  c.instance_ = host.instance;
  c.physical_device_ = host.physical_device;
  c.queue_family_ = host.queue_family;
  describe(c, capabilities, false);
  if (!c.info_.rejected.empty()) throw Error(ErrorCode::unsupported, c.info_.name + ": " + c.info_.rejected);
  c.vk_ = load_device_functions(c.instance_functions_.GetDeviceProcAddr, host.device);
  c.device_ = host.device;
  c.queue_ = host.queue;
  c.lock_queue_ = host.lock_queue;
  c.unlock_queue_ = host.unlock_queue;
  c.allocate_memory_ = host.allocate_memory;
  c.free_memory_ = host.free_memory;
  c.pipeline_cache_ = host.pipeline_cache;
  if (!c.pipeline_cache_) make_pipeline_cache(c, {});
  return context;
}

std::vector<uint8_t> Context::pipeline_cache_data() const {
  for (;;) {
    size_t bytes = 0;
    check(vk_.GetPipelineCacheData(device_, pipeline_cache_, &bytes, nullptr), "vkGetPipelineCacheData");
    std::vector<uint8_t> data(bytes);
    const VkResult result = vk_.GetPipelineCacheData(device_, pipeline_cache_, &bytes, data.data());
    if (result == VK_INCOMPLETE) continue;  // another thread made a pipeline in the meantime
    check(result, "vkGetPipelineCacheData");
    data.resize(bytes);
    return data;
  }
}

Context::Context() : pipelines_(std::make_unique<Pipelines>()) {}

Context::~Context() {
  pipelines_->destroy(vk_, device_);
  if (owns_pipeline_cache_) vk_.DestroyPipelineCache(device_, pipeline_cache_, nullptr);
  if (owns_device_) vk_.DestroyDevice(device_, nullptr);
}

void Context::submit(VkCommandBuffer commands, VkFence fence, const Synchronisation& synchronisation) const {
  const std::vector<VkPipelineStageFlags> stages(synchronisation.wait.size(),
                                                 VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT);
  const Semaphores wait(synchronisation.wait), signal(synchronisation.signal);
  const VkTimelineSemaphoreSubmitInfo values{VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO,
                                             nullptr,
                                             wait.count(),
                                             wait.values.data(),
                                             signal.count(),
                                             signal.values.data()};
  VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
  if (wait.count() || signal.count()) info.pNext = &values;
  info.waitSemaphoreCount = wait.count();
  info.pWaitSemaphores = wait.handles.data();
  info.pWaitDstStageMask = stages.data();
  info.commandBufferCount = 1;
  info.pCommandBuffers = &commands;
  info.signalSemaphoreCount = signal.count();
  info.pSignalSemaphores = signal.handles.data();
  const std::lock_guard lock(queue_mutex_);
  const HostLock host_lock(lock_queue_, unlock_queue_);
  check(vk_.QueueSubmit(queue_, 1, &info, fence), "vkQueueSubmit", info_.name);
}

MemoryBlock Context::allocate(const MemoryRequest& request, const std::string& details) const {
  const VkMemoryRequirements& needs = request.requirements;
  if (allocate_memory_) {
    const MemoryBlock block = allocate_memory_(request);
    if (!block.memory) throw Error(ErrorCode::out_of_memory, "HostDevice::allocate_memory returned no memory: " + details);
    if (block.offset % needs.alignment == 0 && (block.mapped || !request.mapped)) return block;
    free_memory_(block);
    throw Error(ErrorCode::invalid_argument, "HostDevice::allocate_memory returned a block at offset " +
                                                 std::to_string(block.offset) + (block.mapped ? " (mapped)" : " (not mapped)") +
                                                 ", but it must be " + (request.mapped ? "mapped, and " : "") +
                                                 "at a multiple of " + std::to_string(needs.alignment));
  }
  MemoryBlock block;
  const VkMemoryAllocateInfo info{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, nullptr, needs.size,
                                  static_cast<uint32_t>(std::countr_zero(needs.memoryTypeBits))};
  check(vk_.AllocateMemory(device_, &info, nullptr, &block.memory), "vkAllocateMemory", details);
  if (!request.mapped) return block;
  try {
    check(vk_.MapMemory(device_, block.memory, 0, VK_WHOLE_SIZE, 0, &block.mapped), "vkMapMemory", details);
  } catch (...) {
    vk_.FreeMemory(device_, block.memory, nullptr);
    throw;
  }
  return block;
}

void Context::free(const MemoryBlock& block) const noexcept {
  if (free_memory_) return free_memory_(block);
  vk_.FreeMemory(device_, block.memory, nullptr);
}

void Context::name_object(VkObjectType type, uint64_t handle, const std::string& name) const {
  if (!set_name_) return;
  const VkDebugUtilsObjectNameInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT, nullptr, type, handle,
                                           name.c_str()};
  set_name_(device_, &info);  // a failure does no harm
}

std::vector<DeviceInfo> list_devices() {
  const Instance instance(false, {});
  std::vector<DeviceInfo> infos;
  for (VkPhysicalDevice device : instance.physical_devices())
    infos.push_back(info_of(instance.functions(), device, capabilities_of(instance.functions(), device)));
  return infos;
}

std::shared_ptr<Context> create_context(const ContextOptions& options) { return ContextBuilder::create(options); }
std::shared_ptr<Context> adopt_device(const HostDevice& host) { return ContextBuilder::adopt(host); }

}  // namespace iclk::engine
