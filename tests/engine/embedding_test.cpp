// A host application's device: made here, adopted, and still whole afterwards.
#include <gtest/gtest.h>

#include <iclk/engine/error.h>
#include <iclk/engine/internal/instance.h>
#include <iclk/engine/result.h>

#include "kernels.h"

namespace iclk::test {
namespace {

using namespace engine;

/// A renderer in small: instance with validation, device with one queue of the family that requirements() permits, images.
class HostApplication {
 public:
  HostApplication() : instance(true, report_validation) {
    const InstanceFunctions& vk = instance.functions();
    physical = physical_device();
    families = capabilities_of(vk, physical).queue_families;
    family = static_cast<uint32_t>(choose_queue_family(families, requirements().queue_flags));
    const float priority = 1;
    VkDeviceQueueCreateInfo queue_info{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
    queue_info.queueFamilyIndex = family;
    queue_info.queueCount = 1;
    queue_info.pQueuePriorities = &priority;
    VkDeviceCreateInfo info{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
    info.queueCreateInfoCount = 1;
    info.pQueueCreateInfos = &queue_info;
    check(vk.CreateDevice(physical, &info, nullptr, &device), "vkCreateDevice");
    load(create_image, "vkCreateImage");
    load(destroy_image, "vkDestroyImage");
    load(image_requirements, "vkGetImageMemoryRequirements");
    load(bind_image, "vkBindImageMemory");
    load(copy_to_image, "vkCmdCopyBufferToImage");
    functions = load_device_functions(vk.GetDeviceProcAddr, device);
    functions.GetDeviceQueue(device, family, 0, &queue);
  }
  ~HostApplication() {
    EXPECT_EQ(functions.DeviceWaitIdle(device), VK_SUCCESS);  // still alive: nobody else destroyed it
    functions.DestroyDevice(device, nullptr);
  }

  HostDevice handed_over() const {
    return {instance.handle(), physical, device, queue, family, instance.get_instance_proc_addr(), {}, {}, {}};
  }

  Instance instance;
  VkPhysicalDevice physical = VK_NULL_HANDLE;
  std::vector<VkQueueFamilyProperties> families;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  uint32_t family = 0;
  DeviceFunctions functions;
  PFN_vkCreateImage create_image = nullptr;
  PFN_vkDestroyImage destroy_image = nullptr;
  PFN_vkGetImageMemoryRequirements image_requirements = nullptr;
  PFN_vkBindImageMemory bind_image = nullptr;
  PFN_vkCmdCopyBufferToImage copy_to_image = nullptr;

 private:
  VkPhysicalDevice physical_device() const {
    const std::vector<VkPhysicalDevice> all = instance.physical_devices();
    std::vector<DeviceInfo> infos;
    for (VkPhysicalDevice one : all)
      infos.push_back(info_of(instance.functions(), one, capabilities_of(instance.functions(), one)));
    return all[choose_device(infos, watched_options().device).index];
  }
  template <class Function>
  void load(Function& function, const char* name) {
    function = reinterpret_cast<Function>(instance.functions().GetDeviceProcAddr(device, name));
  }
};

constexpr uint32_t count = 256;

TEST(Embedding, AnAdoptedDeviceWorksAndSurvives) {
  ICLK_NEED_DEVICE();
  HostApplication app;
  for (int round = 0; round < 3; ++round) {
    int locked = 0, unlocked = 0;
    HostDevice host = app.handed_over();
    host.lock_queue = [&] { ++locked; };
    host.unlock_queue = [&] {
      ++unlocked;
      EXPECT_EQ(locked, unlocked);
    };
    if (round == 1) host.get_instance_proc_addr = nullptr;  // the loader is found
    const auto context = adopt_device(host);
    EXPECT_FALSE(context->owns_device());
    EXPECT_EQ(context->device(), app.device);
    MemoryPlan plan;
    const BufferId data = plan.add("data", count * 4, MemoryKind::readback, BufferUse::storage);
    const Workspace memory(context, plan);
    const Kernel kernel = scale_kernel(context, 8);
    for (uint32_t i = 0; i < count; ++i) memory[data].as<uint32_t>()[i] = i;
    run(context, [&](Recorder& recorder) {
      recorder.dispatch(kernel, {&memory[data]}, ScalePush{count, 0}, {groups_for(count, 8)});
      recorder.host_read({&memory[data]});
    });
    EXPECT_EQ(memory[data].as<uint32_t>()[count - 1], 3 * (count - 1) + 1);
    EXPECT_EQ(locked, 1);
    EXPECT_EQ(unlocked, 1);
  }
}

TEST(Embedding, TheHostsPipelineCacheIsUsedAndKept) {
  ICLK_NEED_DEVICE();
  HostApplication app;
  HostDevice host = app.handed_over();
  const VkPipelineCacheCreateInfo info{VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO, nullptr, 0, 0, nullptr};
  check(app.functions.CreatePipelineCache(app.device, &info, nullptr, &host.pipeline_cache), "vkCreatePipelineCache");
  {
    const auto context = adopt_device(host);
    EXPECT_EQ(context->pipeline_cache(), host.pipeline_cache);
    scale_kernel(context, 8);
  }
  app.functions.DestroyPipelineCache(app.device, host.pipeline_cache, nullptr);  // a second destruction would be a message
}

/// An 8-bit colour image of the application, filled with texel i = i in layout `layout`.
struct HostImage {
  static constexpr uint32_t width = 16, height = 8;

  HostImage(HostApplication& host, const std::shared_ptr<Context>& context, VkImageLayout layout) : app(host) {
    VkImageCreateInfo info{VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO};
    info.imageType = VK_IMAGE_TYPE_2D;
    info.format = VK_FORMAT_R8G8B8A8_UNORM;
    info.extent = {width, height, 1};
    info.mipLevels = info.arrayLayers = 1;
    info.samples = VK_SAMPLE_COUNT_1_BIT;
    info.tiling = VK_IMAGE_TILING_OPTIMAL;
    info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT;
    check(app.create_image(app.device, &info, nullptr, &image), "vkCreateImage");
    VkMemoryRequirements needs;
    app.image_requirements(app.device, image, &needs);
    const int type = [&] {
      for (uint32_t i = 0; i < 32; ++i)
        if (needs.memoryTypeBits >> i & 1) return static_cast<int>(i);
      return -1;
    }();
    const VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, nullptr, needs.size,
                                        static_cast<uint32_t>(type)};
    check(app.functions.AllocateMemory(app.device, &allocate, nullptr, &memory), "vkAllocateMemory");
    check(app.bind_image(app.device, image, memory, 0), "vkBindImageMemory");
    fill(context, layout);
    foreign = {image, info.format, width, height, layout, VK_QUEUE_FAMILY_IGNORED};
  }
  ~HostImage() {
    app.destroy_image(app.device, image, nullptr);
    app.functions.FreeMemory(app.device, memory, nullptr);
  }

  void fill(const std::shared_ptr<Context>& context, VkImageLayout layout) {
    MemoryPlan plan;
    const BufferId texels = plan.add("texels", width * height * 4, MemoryKind::upload, BufferUse::transfer);
    const Workspace staging(context, plan);
    for (uint32_t i = 0; i < width * height; ++i) staging[texels].as<uint32_t>()[i] = i;
    Submission submission(context);
    const VkCommandBuffer commands = submission.begin();
    VkImageMemoryBarrier barrier{VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER};
    barrier.image = image;
    barrier.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
    barrier.srcQueueFamilyIndex = barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.dstAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    barrier.newLayout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    const VkPipelineStageFlags transfer = VK_PIPELINE_STAGE_TRANSFER_BIT, compute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
    app.functions.CmdPipelineBarrier(commands, transfer, transfer, 0, 0, nullptr, 0, nullptr, 1, &barrier);
    const VkBufferImageCopy region{0, 0, 0, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1}, {0, 0, 0}, {width, height, 1}};
    app.copy_to_image(commands, staging[texels].handle, image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &region);
    barrier.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    barrier.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_TRANSFER_READ_BIT;
    barrier.oldLayout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    barrier.newLayout = layout;
    app.functions.CmdPipelineBarrier(commands, transfer, compute | transfer, 0, 0, nullptr, 0, nullptr, 1, &barrier);
    submission.end();
    submission.submit_and_wait();
  }

  HostApplication& app;
  VkImage image = VK_NULL_HANDLE;
  VkDeviceMemory memory = VK_NULL_HANDLE;
  ForeignImage foreign;
};

/// A command buffer of the application, as it would make one.
struct HostCommands {
  explicit HostCommands(HostApplication& host) : app(host) {
    const VkCommandPoolCreateInfo pool_info{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr, 0, app.family};
    check(app.functions.CreateCommandPool(app.device, &pool_info, nullptr, &pool), "vkCreateCommandPool");
    const VkCommandBufferAllocateInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr, pool,
                                           VK_COMMAND_BUFFER_LEVEL_PRIMARY, 1};
    check(app.functions.AllocateCommandBuffers(app.device, &info, &commands), "vkAllocateCommandBuffers");
    const VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    check(app.functions.BeginCommandBuffer(commands, &begin), "vkBeginCommandBuffer");
  }
  void submit_and_wait() {
    check(app.functions.EndCommandBuffer(commands), "vkEndCommandBuffer");
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
  ~HostCommands() { app.functions.DestroyCommandPool(app.device, pool, nullptr); }

  HostApplication& app;
  VkCommandPool pool = VK_NULL_HANDLE;
  VkCommandBuffer commands = VK_NULL_HANDLE;
};

TEST(Embedding, TwoRecordingsInOneForeignCommandBufferReadAHostImage) {
  ICLK_NEED_DEVICE();
  HostApplication app;
  const auto context = adopt_device(app.handed_over());
  const Kernel kernel = scale_kernel(context, 8);
  for (VkImageLayout layout :
       {VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, VK_IMAGE_LAYOUT_GENERAL, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL}) {
    HostImage image(app, context, layout);
    constexpr uint32_t texels = HostImage::width * HostImage::height, pitch = 20;
    MemoryPlan plan;
    const BufferId shared = plan.add("shared", 4096, MemoryKind::device, BufferUse::storage);
    const BufferId result = plan.add("result", 4096, MemoryKind::readback, BufferUse::transfer);
    const Workspace memory(context, plan);
    HostCommands host(app);
    DescriptorArena first_arena(context, {.sets = 1, .storage = 1}), second_arena(context, {.sets = 1, .storage = 1});
    {
      Recorder first(*context, host.commands, first_arena);
      first.copy_image_to_buffer(image.foreign, memory[shared], 16, pitch);
      first.dispatch(kernel, {&memory[shared]}, ScalePush{1024, 0}, {128});
    }
    {
      Recorder second(*context, host.commands, second_arena);  // over the same buffer, knowing nothing of the first
      second.dispatch(kernel, {&memory[shared]}, ScalePush{1024, 0}, {128});
      second.copy(memory[shared], memory[result], 4096);
      second.copy_image_to_buffer(image.foreign, memory[shared]);
      second.copy(memory[shared], memory[result], std::vector{VkBufferCopy{0, 2048, texels * 4}});
      second.host_read({&memory[result]});
    }
    host.submit_and_wait();
    const uint32_t* words = memory[result].as<uint32_t>();
    for (uint32_t v = 0; v < HostImage::height; ++v)
      for (uint32_t u = 0; u < HostImage::width; ++u) {
        const uint32_t i = v * HostImage::width + u;
        ASSERT_EQ(words[4 + v * pitch + u], 9 * i + 4) << layout;
        ASSERT_EQ(words[512 + i], i) << layout;
      }
  }
}

TEST(Embedding, ImagesThatCannotBeReadAreRejected) {
  ICLK_NEED_DEVICE();
  HostApplication app;
  const auto context = adopt_device(app.handed_over());
  const HostImage image(app, context, VK_IMAGE_LAYOUT_GENERAL);
  MemoryPlan plan;
  const BufferId small = plan.add("small", HostImage::width * HostImage::height * 4, MemoryKind::device, BufferUse::storage);
  const Workspace memory(context, plan);
  run(context, [&](Recorder& recorder) {
    const auto rejected = [&](auto change, VkDeviceSize offset = 0, uint32_t pitch = 0) {
      ForeignImage foreign = image.foreign;
      change(foreign);
      try {
        recorder.copy_image_to_buffer(foreign, memory[small], offset, pitch);
        return false;
      } catch (const Error& error) {
        return error.code() == ErrorCode::invalid_argument;
      }
    };
    EXPECT_TRUE(rejected([](ForeignImage& f) { f.handle = VK_NULL_HANDLE; }));
    EXPECT_TRUE(rejected([](ForeignImage& f) { f.layout = VK_IMAGE_LAYOUT_UNDEFINED; }));
    EXPECT_TRUE(rejected([](ForeignImage& f) { f.format = VK_FORMAT_BC1_RGB_UNORM_BLOCK; }));
    EXPECT_TRUE(rejected([](ForeignImage& f) { f.width = 0; }));
    EXPECT_TRUE(rejected([](ForeignImage& f) { f.height = UINT32_MAX; }));
    EXPECT_TRUE(rejected([](ForeignImage&) {}, 16));
    EXPECT_TRUE(rejected([](ForeignImage&) {}, 2));
    EXPECT_TRUE(rejected([](ForeignImage&) {}, 0, HostImage::width - 1));
    EXPECT_TRUE(rejected([](ForeignImage&) {}, 0, HostImage::width + 1));
    EXPECT_FALSE(rejected([](ForeignImage&) {}));
  });
}

TEST(Embedding, AHalfFilledHostDeviceIsRejectedByName) {
  ICLK_NEED_DEVICE();
  HostApplication app;
  const auto refusal = [&](auto change) -> std::string {
    HostDevice host = app.handed_over();
    change(host);
    try {
      adopt_device(host);
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      return error.what();
    }
    return "accepted";
  };
  EXPECT_EQ(refusal([](HostDevice& h) { h.instance = VK_NULL_HANDLE; }), "HostDevice: instance is null");
  EXPECT_EQ(refusal([](HostDevice& h) { h.physical_device = VK_NULL_HANDLE; }), "HostDevice: physical_device is null");
  EXPECT_EQ(refusal([](HostDevice& h) { h.device = VK_NULL_HANDLE; }), "HostDevice: device is null");
  EXPECT_EQ(refusal([](HostDevice& h) { h.queue = VK_NULL_HANDLE; }), "HostDevice: queue is null");
  EXPECT_NE(refusal([](HostDevice& h) { h.lock_queue = [] {}; }).find("together"), std::string::npos);
  EXPECT_NE(refusal([](HostDevice& h) { h.queue_family = 77; }).find("queue_family 77 does not exist"), std::string::npos);
  EXPECT_EQ(refusal([](HostDevice&) {}), "accepted");
}

}  // namespace
}  // namespace iclk::test
