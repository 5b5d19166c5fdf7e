#pragma once
#include <algorithm>
#include <cstring>

#include <gtest/gtest.h>

#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/internal/instance.h>
#include <iclk/engine/result.h>
#include <iclk/engine/submission.h>

#include "device.h"

namespace iclk::test {

using namespace engine;  // NOLINT: a test's vocabulary

/// An application in small: its own instance with validation and a device with one queue of the family that requirements()
/// permits (compute without graphics where there is one).
class Application {
 public:
  Application() : instance(true, report_validation) {
    const InstanceFunctions& vk = instance.functions();
    const std::vector<VkPhysicalDevice> all = instance.physical_devices();
    std::vector<DeviceInfo> infos;
    for (VkPhysicalDevice one : all) infos.push_back(info_of(vk, one, capabilities_of(vk, one)));
    physical = all[choose_device(infos, watched_options().device).index];
    family =
        static_cast<uint32_t>(choose_queue_family(capabilities_of(vk, physical).queue_families, requirements().queue_flags));
    const float priority = 1;
    VkDeviceQueueCreateInfo queue_info{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
    queue_info.queueFamilyIndex = family;
    queue_info.queueCount = 1;
    queue_info.pQueuePriorities = &priority;
    VkDeviceCreateInfo info{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
    info.queueCreateInfoCount = 1;
    info.pQueueCreateInfos = &queue_info;
    const DeviceCapabilities offered = capabilities_of(vk, physical);
    std::vector<std::string> enabled = extensions_to_enable(requirements(), offered);
    timelines = std::count(offered.device_extensions.begin(), offered.device_extensions.end(), "VK_KHR_timeline_semaphore");
    if (timelines) enabled.push_back("VK_KHR_timeline_semaphore");
    std::vector<const char*> extensions;
    for (const std::string& extension : enabled) extensions.push_back(extension.c_str());
    VkPhysicalDeviceTimelineSemaphoreFeatures timeline{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES};
    timeline.timelineSemaphore = VK_TRUE;
    if (timelines) info.pNext = &timeline;
    info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
    info.ppEnabledExtensionNames = extensions.data();
    check(vk.CreateDevice(physical, &info, nullptr, &device), "vkCreateDevice");
    functions = load_device_functions(vk.GetDeviceProcAddr, device);
    load(create_image, "vkCreateImage");
    load(destroy_image, "vkDestroyImage");
    load(create_view, "vkCreateImageView");
    load(destroy_view, "vkDestroyImageView");
    load(image_requirements, "vkGetImageMemoryRequirements");
    load(bind_image, "vkBindImageMemory");
    load(copy_to_image, "vkCmdCopyBufferToImage");
    load(create_semaphore, "vkCreateSemaphore");
    load(destroy_semaphore, "vkDestroySemaphore");
    load(signal_semaphore, "vkSignalSemaphoreKHR");
    load(wait_semaphores, "vkWaitSemaphoresKHR");
    functions.GetDeviceQueue(device, family, 0, &queue);
  }
  ~Application() {
    EXPECT_EQ(functions.DeviceWaitIdle(device), VK_SUCCESS);  // still alive: nobody else destroyed it
    functions.DestroyDevice(device, nullptr);
  }
  HostDevice handed_over() const {
    HostDevice host{instance.handle(), physical, device, queue, family};
    host.get_instance_proc_addr = instance.get_instance_proc_addr();
    return host;
  }
  std::shared_ptr<Context> adopt() const { return adopt_device(handed_over()); }

  Instance instance;
  VkPhysicalDevice physical = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  uint32_t family = 0;
  DeviceFunctions functions;
  PFN_vkCreateImage create_image = nullptr;
  PFN_vkDestroyImage destroy_image = nullptr;
  PFN_vkCreateImageView create_view = nullptr;
  PFN_vkDestroyImageView destroy_view = nullptr;
  PFN_vkGetImageMemoryRequirements image_requirements = nullptr;
  PFN_vkBindImageMemory bind_image = nullptr;
  PFN_vkCmdCopyBufferToImage copy_to_image = nullptr;
  bool timelines = false;  // timeline semaphores are enabled
  PFN_vkCreateSemaphore create_semaphore = nullptr;
  PFN_vkDestroySemaphore destroy_semaphore = nullptr;
  PFN_vkSignalSemaphore signal_semaphore = nullptr;
  PFN_vkWaitSemaphores wait_semaphores = nullptr;

 private:
  template <class Function>
  void load(Function& function, const char* name) {
    function = reinterpret_cast<Function>(instance.functions().GetDeviceProcAddr(device, name));
  }
};

/// A timeline semaphore of the application.
struct Timeline {
  explicit Timeline(Application& application) : app(application) {
    const VkSemaphoreTypeCreateInfo type{VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO, nullptr, VK_SEMAPHORE_TYPE_TIMELINE, 0};
    const VkSemaphoreCreateInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO, &type, 0};
    check(app.create_semaphore(app.device, &info, nullptr, &handle), "vkCreateSemaphore");
  }
  ~Timeline() { app.destroy_semaphore(app.device, handle, nullptr); }
  void signal(uint64_t value) const {
    const VkSemaphoreSignalInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_SIGNAL_INFO, nullptr, handle, value};
    check(app.signal_semaphore(app.device, &info), "vkSignalSemaphore");
  }
  /// Whether it reached `value` within so many nanoseconds.
  bool wait(uint64_t value, uint64_t nanoseconds = UINT64_MAX) const {
    const VkSemaphoreWaitInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO, nullptr, 0, 1, &handle, &value};
    const VkResult result = app.wait_semaphores(app.device, &info, nanoseconds);
    check(result, "vkWaitSemaphores");
    return result == VK_SUCCESS;
  }
  Application& app;
  VkSemaphore handle = VK_NULL_HANDLE;
};

/// An image of the application, kept in one layout.
struct ApplicationImage {
  ApplicationImage(Application& application, uint32_t width, uint32_t height, VkFormat format, VkImageLayout kept_in,
                   uint32_t mips = 1, uint32_t layers = 1)
      : app(application), layout(kept_in) {
    VkImageCreateInfo info{VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO};
    info.imageType = VK_IMAGE_TYPE_2D;
    info.format = format;
    info.extent = {width, height, 1};
    info.mipLevels = mips;
    info.arrayLayers = layers;
    info.samples = VK_SAMPLE_COUNT_1_BIT;
    info.tiling = VK_IMAGE_TILING_OPTIMAL;
    info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT;
    check(app.create_image(app.device, &info, nullptr, &image), "vkCreateImage");
    VkMemoryRequirements needs;
    app.image_requirements(app.device, image, &needs);
    uint32_t type = 0;
    while (!(needs.memoryTypeBits >> type & 1)) ++type;
    const VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, nullptr, needs.size, type};
    check(app.functions.AllocateMemory(app.device, &allocate, nullptr, &memory), "vkAllocateMemory");
    check(app.bind_image(app.device, image, memory, 0), "vkBindImageMemory");
    foreign = {image, format, width, height, layout, VK_QUEUE_FAMILY_IGNORED};
  }
  ~ApplicationImage() {
    for (const VkImageView view : views) app.destroy_view(app.device, view, nullptr);
    app.destroy_image(app.device, image, nullptr);
    app.functions.FreeMemory(app.device, memory, nullptr);
  }
  ApplicationImage(const ApplicationImage&) = delete;
  ApplicationImage& operator=(const ApplicationImage&) = delete;

  /// Of one mip level and layer.
  VkImageView view(uint32_t mip = 0, uint32_t layer = 0) {
    VkImageViewCreateInfo info{VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO};
    info.image = image;
    info.viewType = VK_IMAGE_VIEW_TYPE_2D;
    info.format = foreign.format;
    info.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, mip, 1, layer, 1};
    VkImageView made = VK_NULL_HANDLE;
    check(app.create_view(app.device, &info, nullptr, &made), "vkCreateImageView");
    views.push_back(made);
    return made;
  }

  void fill(const std::shared_ptr<Context>& context, const void* pixels, size_t bytes, uint32_t mip = 0, uint32_t layer = 0) {
    MemoryPlan plan;
    const BufferId id = plan.add("pixels", bytes, MemoryKind::upload, BufferUse::transfer);
    const Workspace staging(context, plan);
    std::memcpy(staging[id].mapped, pixels, bytes);
    Submission submission(context);
    const VkCommandBuffer commands = submission.begin();
    VkImageMemoryBarrier barrier{VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER};
    barrier.image = image;
    barrier.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, mip, 1, layer, 1};
    barrier.srcQueueFamilyIndex = barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.dstAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    barrier.newLayout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    const VkPipelineStageFlags transfer = VK_PIPELINE_STAGE_TRANSFER_BIT, compute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
    app.functions.CmdPipelineBarrier(commands, transfer | compute, transfer, 0, 0, nullptr, 0, nullptr, 1, &barrier);
    const VkBufferImageCopy region{
        0, 0, 0, {VK_IMAGE_ASPECT_COLOR_BIT, mip, layer, 1}, {0, 0, 0}, {foreign.width >> mip, foreign.height >> mip, 1}};
    app.copy_to_image(commands, staging[id].handle, image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &region);
    barrier.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    barrier.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_TRANSFER_READ_BIT;
    barrier.oldLayout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    barrier.newLayout = layout;
    app.functions.CmdPipelineBarrier(commands, transfer, compute | transfer, 0, 0, nullptr, 0, nullptr, 1, &barrier);
    submission.end();
    submission.submit_and_wait();
  }

  Application& app;
  VkImageLayout layout;
  VkImage image = VK_NULL_HANDLE;
  VkDeviceMemory memory = VK_NULL_HANDLE;
  std::vector<VkImageView> views;
  ForeignImage foreign;
};

/// A command buffer of the application, in the recording state at first; submitted as often as wanted.
struct ApplicationCommands {
  explicit ApplicationCommands(Application& application) : app(application) {
    const VkCommandPoolCreateInfo pool_info{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr, 0, app.family};
    check(app.functions.CreateCommandPool(app.device, &pool_info, nullptr, &pool), "vkCreateCommandPool");
    const VkCommandBufferAllocateInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr, pool,
                                           VK_COMMAND_BUFFER_LEVEL_PRIMARY, 1};
    check(app.functions.AllocateCommandBuffers(app.device, &info, &commands), "vkAllocateCommandBuffers");
    const VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    check(app.functions.BeginCommandBuffer(commands, &begin), "vkBeginCommandBuffer");
  }
  ~ApplicationCommands() { app.functions.DestroyCommandPool(app.device, pool, nullptr); }
  void end() const { check(app.functions.EndCommandBuffer(commands), "vkEndCommandBuffer"); }
  void submit_and_wait() const {
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &commands;
    const VkFenceCreateInfo fence_info{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO, nullptr, 0};
    VkFence fence = VK_NULL_HANDLE;
    check(app.functions.CreateFence(app.device, &fence_info, nullptr, &fence), "vkCreateFence");
    check(app.functions.QueueSubmit(app.queue, 1, &info, fence), "vkQueueSubmit");
    check(app.functions.WaitForFences(app.device, 1, &fence, VK_TRUE, UINT64_MAX), "vkWaitForFences");
    app.functions.DestroyFence(app.device, fence, nullptr);
  }

  Application& app;
  VkCommandPool pool = VK_NULL_HANDLE;
  VkCommandBuffer commands = VK_NULL_HANDLE;
};

}  // namespace iclk::test
