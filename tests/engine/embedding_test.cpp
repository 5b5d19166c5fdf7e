// A host application's device: made here, adopted, and still whole afterwards.
#include <numeric>

#include <iclk/engine/error.h>

#include "host_application.h"
#include "kernels.h"

namespace iclk::test {
namespace {

using namespace engine;

constexpr uint32_t count = 256;

TEST(Embedding, AnAdoptedDeviceWorksAndSurvives) {
  ICLK_NEED_DEVICE();
  Application app;
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
  Application app;
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

/// An 8-bit colour image of the application, texel i = i.
struct Numbered : ApplicationImage {
  static constexpr uint32_t width = 16, height = 8;
  Numbered(Application& app, const std::shared_ptr<Context>& context, VkImageLayout layout)
      : ApplicationImage(app, width, height, VK_FORMAT_R8G8B8A8_UNORM, layout) {
    std::vector<uint32_t> texels(width * height);
    std::iota(texels.begin(), texels.end(), 0u);
    fill(context, texels.data(), 4 * texels.size());
  }
};

TEST(Embedding, TwoRecordingsInOneForeignCommandBufferReadAHostImage) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Kernel kernel = scale_kernel(context, 8);
  for (VkImageLayout layout :
       {VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, VK_IMAGE_LAYOUT_GENERAL, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL}) {
    Numbered image(app, context, layout);
    constexpr uint32_t texels = Numbered::width * Numbered::height, pitch = 20;
    MemoryPlan plan;
    const BufferId shared = plan.add("shared", 4096, MemoryKind::device, BufferUse::storage);
    const BufferId result = plan.add("result", 4096, MemoryKind::readback, BufferUse::transfer);
    const Workspace memory(context, plan);
    ApplicationCommands host(app);
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
    host.end();
    host.submit_and_wait();
    const uint32_t* words = memory[result].as<uint32_t>();
    for (uint32_t v = 0; v < Numbered::height; ++v)
      for (uint32_t u = 0; u < Numbered::width; ++u) {
        const uint32_t i = v * Numbered::width + u;
        ASSERT_EQ(words[4 + v * pitch + u], 9 * i + 4) << layout;
        ASSERT_EQ(words[512 + i], i) << layout;
      }
  }
}

TEST(Embedding, ImagesThatCannotBeReadAreRejected) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Numbered image(app, context, VK_IMAGE_LAYOUT_GENERAL);
  MemoryPlan plan;
  const BufferId small = plan.add("small", Numbered::width * Numbered::height * 4, MemoryKind::device, BufferUse::storage);
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
    EXPECT_TRUE(rejected([](ForeignImage&) {}, 0, Numbered::width - 1));
    EXPECT_TRUE(rejected([](ForeignImage&) {}, 0, Numbered::width + 1));
    EXPECT_FALSE(rejected([](ForeignImage&) {}));
  });
}

TEST(Embedding, AHalfFilledHostDeviceIsRejectedByName) {
  ICLK_NEED_DEVICE();
  Application app;
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
