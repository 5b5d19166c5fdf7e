// A host application's device: made here, adopted, and still whole afterwards.
#include <bit>
#include <map>
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

/// Hands out parts of one allocation a memory type, as VMA does, and counts.
struct Allocator {
  static constexpr VkDeviceSize kRoom = 4 << 20, kBegin = 192;
  explicit Allocator(Application& app) : app(app) {}
  ~Allocator() {
    EXPECT_EQ(given, 0);
    for (const auto& [type, pool] : pools) app.functions.FreeMemory(app.device, pool.memory, nullptr);
  }
  MemoryBlock allocate(const MemoryRequest& request) {
    const VkMemoryRequirements& needs = request.requirements;
    EXPECT_EQ(std::popcount(needs.memoryTypeBits), 1);
    const auto type = static_cast<uint32_t>(std::countr_zero(needs.memoryTypeBits));
    if (refuse) return {};
    Pool& pool = pools[type];
    if (!pool.memory) {
      const VkMemoryAllocateInfo info{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, nullptr, kRoom, type};
      check(app.functions.AllocateMemory(app.device, &info, nullptr, &pool.memory), "vkAllocateMemory");
      if (request.properties & VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT)
        check(app.functions.MapMemory(app.device, pool.memory, 0, VK_WHOLE_SIZE, 0, &pool.mapped), "vkMapMemory");
    }
    const VkDeviceSize offset = (pool.used + needs.alignment - 1) / needs.alignment * needs.alignment + shift;
    pool.used = offset + needs.size;
    EXPECT_LE(pool.used, kRoom);
    ++given;
    return {pool.memory, offset, pool.mapped ? static_cast<std::byte*>(pool.mapped) + offset : nullptr, this};
  }
  void free(const MemoryBlock& block) {
    EXPECT_EQ(block.handle, this);
    --given;
  }
  HostDevice with(HostDevice host) {
    host.allocate_memory = [this](const MemoryRequest& request) { return allocate(request); };
    host.free_memory = [this](const MemoryBlock& block) { free(block); };
    return host;
  }
  struct Pool {
    VkDeviceMemory memory = VK_NULL_HANDLE;
    void* mapped = nullptr;
    VkDeviceSize used = kBegin;  // somebody else has the beginning
  };
  Application& app;
  std::map<uint32_t, Pool> pools;
  int given = 0;
  bool refuse = false;
  VkDeviceSize shift = 0;
};

TEST(Embedding, AllMemoryComesFromTheHostsAllocator) {
  ICLK_NEED_DEVICE();
  Application app;
  Allocator allocator(app);
  const auto context = adopt_device(allocator.with(app.handed_over()));
  MemoryPlan plan;
  const BufferId in = plan.add("in", count * 4, MemoryKind::upload, BufferUse::transfer),
                 data = plan.add("data", count * 4, MemoryKind::device, BufferUse::storage),
                 table = plan.add("table", count * 4, MemoryKind::table, BufferUse::storage),
                 out = plan.add("out", count * 8, MemoryKind::readback, BufferUse::transfer);
  {
    const Workspace memory(context, plan);
    EXPECT_GE(allocator.given, 1);
    const Kernel kernel = scale_kernel(context, 8);
    std::iota(memory[in].as<uint32_t>(), memory[in].as<uint32_t>() + count, 0u);
    std::iota(memory[table].as<uint32_t>(), memory[table].as<uint32_t>() + count, 1000u);
    run(context, [&](Recorder& recorder) {
      recorder.copy(memory[in], memory[data], count * 4);
      recorder.upload(memory[table], 0, count * 4);
      recorder.dispatch(kernel, {&memory[data]}, ScalePush{count, 0}, {groups_for(count, 8)});
      recorder.dispatch(kernel, {&memory[table]}, ScalePush{count, 0}, {groups_for(count, 8)});
      recorder.copy(memory[data], memory[out], count * 4);
      const VkBufferCopy second{0, count * 4, count * 4};
      recorder.copy(memory[table], memory[out], std::span(&second, 1));
      recorder.host_read({&memory[out]});
    });
    EXPECT_EQ(memory[out].as<uint32_t>()[count - 1], 3 * (count - 1) + 1);
    EXPECT_EQ(memory[out].as<uint32_t>()[count], 3 * 1000u + 1);
  }
  EXPECT_EQ(allocator.given, 0);

  allocator.refuse = true;
  try {
    const Workspace none(context, plan);
    ADD_FAILURE() << "memory out of nowhere";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::out_of_memory);
    EXPECT_NE(std::string(error.what()).find("allocate_memory"), std::string::npos) << error.what();
  }
  allocator.refuse = false;
  allocator.shift = 4;  // no multiple of any alignment
  EXPECT_THROW(Workspace(context, plan), Error);
  EXPECT_EQ(allocator.given, 0);
}

TEST(Embedding, AnAllocatorIsWholeOrNone) {
  ICLK_NEED_DEVICE();
  Application app;
  HostDevice host = app.handed_over();
  host.free_memory = [](const MemoryBlock&) {};
  EXPECT_THROW(adopt_device(host), Error);
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
