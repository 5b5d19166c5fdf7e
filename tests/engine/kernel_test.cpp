#include "kernels.h"

#include <pthread.h>

#include <numeric>
#include <system_error>
#include <thread>

#include <gtest/gtest.h>

#include <iclk/engine/error.h>

#include "scale.comp.spv.h"
#include "sum.comp.spv.h"

namespace iclk::test {

using namespace engine;

Kernel sum_kernel(std::shared_ptr<const Context> context, uint32_t workgroup, int32_t factor) {
  return Kernel(std::move(context),
                {.name = "sum",
                 .spirv = sum_comp_spv,
                 .bindings = {BindingKind::storage_read, BindingKind::texel_read, BindingKind::storage_write},
                 .push_constant_bytes = sizeof(SumPush),
                 .specialization = {workgroup, static_cast<uint32_t>(factor)}});
}

Kernel scale_kernel(std::shared_ptr<const Context> context, uint32_t workgroup) {
  return Kernel(std::move(context), {.name = "scale",
                                     .spirv = scale_comp_spv,
                                     .bindings = {BindingKind::storage_read_write},
                                     .push_constant_bytes = sizeof(ScalePush),
                                     .specialization = {workgroup}});
}

void run(std::shared_ptr<const Context> context, const std::function<void(Recorder&)>& record, StageTimer* timer) {
  DescriptorArena arena(context, {.sets = 16, .storage = 64, .texel = 16, .uniform = 4});
  Submission submission(context);
  Recorder recorder(submission, arena, timer);
  record(recorder);
  submission.end();
  submission.submit_and_wait();
}

namespace {

constexpr uint32_t count = 1000;  // no multiple of a workgroup

struct Sum {
  Workspace memory;
  BufferId source, texels, result;
  Sum() {
    MemoryPlan plan;
    source = plan.add("source", count * 4, MemoryKind::upload, BufferUse::storage);
    texels = plan.add("texels", count * 4, MemoryKind::upload, BufferUse::storage | BufferUse::texel, VK_FORMAT_R32_SFLOAT);
    result = plan.add("result", count * 4, MemoryKind::readback, BufferUse::storage);
    memory = Workspace(device(), plan);
    for (uint32_t i = 0; i < count; ++i) {
      memory[source].as<int>()[i] = static_cast<int>(i);
      memory[texels].as<float>()[i] = static_cast<float>(2 * i);
      memory[result].as<int>()[i] = -1;
    }
  }
};

TEST(Kernel, SpecializationPushConstantsAndTexels) {
  ICLK_NEED_DEVICE();
  for (uint32_t workgroup : {1u, 8u, 64u, 128u}) {
    Sum data;
    const Kernel kernel = sum_kernel(device(), workgroup, -7);
    run(device(), [&](Recorder& recorder) {
      recorder.dispatch(kernel, {&data.memory[data.source], &data.memory[data.texels], &data.memory[data.result]},
                        SumPush{5, count - 1}, {groups_for(count, workgroup)});
      recorder.host_read({&data.memory[data.result]});
    });
    const int* result = data.memory[data.result].as<int>();
    for (int i = 0; i < static_cast<int>(count) - 1; ++i) ASSERT_EQ(result[i], -21 * i + 5) << workgroup;
    EXPECT_EQ(result[count - 1], -1);
  }
}

TEST(Kernel, EqualDescriptionsAreOnePipelineOfTheirContext) {
  ICLK_NEED_DEVICE();
  std::vector<uint32_t> words(scale_comp_spv.texels.begin(), scale_comp_spv.texels.end());
  const auto pipeline_of = [&](const std::shared_ptr<const Context>& context, const char* name, uint32_t workgroup) {
    return Kernel(context, {.name = name,
                            .spirv = words,
                            .bindings = {BindingKind::storage_read_write},
                            .push_constant_bytes = sizeof(ScalePush),
                            .specialization = {workgroup}})
        .pipeline();
  };
  const VkPipeline first = pipeline_of(device(), "scale", 8);
  EXPECT_EQ(pipeline_of(device(), "scale", 8), first) << "also when the first kernel is gone";
  EXPECT_NE(pipeline_of(device(), "scale", 4), first);
  EXPECT_NE(pipeline_of(device(), "scaled", 8), first) << "messages name it";
  ++words[2];  // whose generator it is, which means nothing
  EXPECT_NE(pipeline_of(device(), "scale", 8), first) << "other code at the same place";
}

TEST(Kernel, ADeferredOneIsCheckedAtOnceAndMadeWhereItIsRecorded) {
  ICLK_NEED_DEVICE();
  KernelDescription description{.name = "deferred",
                                .spirv = scale_comp_spv,
                                .bindings = {BindingKind::storage_read_write},
                                .push_constant_bytes = 2,
                                .specialization = {8}};
  EXPECT_THROW(Kernel::deferred(device(), description), Error);
  description.push_constant_bytes = sizeof(ScalePush);
  std::vector<uint32_t> words(scale_comp_spv.texels.begin(), scale_comp_spv.texels.end());
  description.spirv = words;
  const Kernel deferred = Kernel::deferred(device(), description), copy = deferred;
  words[2] += 7;  // read now: other code than an eager kernel of before has
  const Kernel eager(device(), description);
  EXPECT_EQ(deferred.pipeline(), eager.pipeline()) << "it was made too early";
  EXPECT_EQ(copy.pipeline(), deferred.pipeline());
}

/// While it lives, no thread can be started: none has room for its stack.
class NoThreads {
 public:
  NoThreads() {
    pthread_getattr_default_np(&before_);
    pthread_attr_t attributes;
    pthread_getattr_default_np(&attributes);
    pthread_attr_setstacksize(&attributes, size_t{1} << 50);
    pthread_setattr_default_np(&attributes);
    pthread_attr_destroy(&attributes);
  }
  ~NoThreads() {
    pthread_setattr_default_np(&before_);
    pthread_attr_destroy(&before_);
  }

 private:
  pthread_attr_t before_;
};

TEST(Kernel, AreMadeOneByOneWhereThereAreNoThreads) {
  ICLK_NEED_DEVICE();
  Kernel a, b;
  KernelBatch batch(device());
  for (const auto& [kernel, workgroup] : {std::pair(&a, 16u), {&b, 32u}})
    batch.add(*kernel, {.name = "scale",
                        .spirv = scale_comp_spv,
                        .bindings = {BindingKind::storage_read_write},
                        .push_constant_bytes = sizeof(ScalePush),
                        .specialization = {workgroup}});
  const NoThreads none;
  EXPECT_THROW(std::thread([] {}).join(), std::system_error);
  EXPECT_NO_THROW(batch.make());
  EXPECT_EQ(a.bindings().size(), 1u);
  EXPECT_EQ(b.bindings().size(), 1u);
}

TEST(Kernel, RejectsWhatIsNotSpirvAndNamesIt) {
  ICLK_NEED_DEVICE();
  const std::vector<uint32_t> text(8, 0x41414141);
  try {
    Kernel(device(), {.name = "hello", .spirv = text, .bindings = {}, .push_constant_bytes = 0, .specialization = {}});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    EXPECT_NE(std::string(error.what()).find("hello"), std::string::npos);
  }
}

TEST(Kernel, MoreThanTheDeviceHasIsUnsupported) {
  ICLK_NEED_DEVICE();
  KernelDescription description{
      .name = "wide", .spirv = scale_comp_spv, .bindings = {}, .push_constant_bytes = 0, .specialization = {}};
  description.push_constant_bytes = (device()->limits().maxPushConstantsSize / 4 + 1) * 4;
  try {
    Kernel(device(), description);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unsupported);
    EXPECT_NE(std::string(error.what()).find("maxPushConstantsSize"), std::string::npos) << error.what();
  }
}

TEST(Kernel, MismatchedDispatchIsRejected) {
  ICLK_NEED_DEVICE();
  Sum data;
  const Kernel kernel = sum_kernel(device(), 8, 1);
  const Buffer &source = data.memory[data.source], &texels = data.memory[data.texels], &result = data.memory[data.result];
  run(device(), [&](Recorder& recorder) {
    const SumPush push{0, count};
    EXPECT_THROW(recorder.dispatch(kernel, {&source, &texels}, push, {1}), Error);
    if (!device()->storage_reads()) {
      EXPECT_THROW(recorder.dispatch(kernel, {&source, &source, &result}, push, {1}), Error);  // no texel view
    }
    EXPECT_THROW(recorder.dispatch(kernel, {&source, &texels, nullptr}, push, {1}), Error);
    EXPECT_THROW(recorder.dispatch(kernel, {&source, &texels, &result}, {1}), Error);  // no push constants
    try {
      recorder.dispatch(kernel, {&source, &texels, &result}, push, {1, UINT32_MAX});
      FAIL();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::unsupported);
    }
    recorder.dispatch(kernel, {&source, &texels, &result}, push, {0});
    EXPECT_EQ(recorder.dispatches(), 0u);
  });
  EXPECT_EQ(result.as<int>()[0], -1);
}

TEST(Kernel, OutlivesTheHandleToItsContext) {
  ICLK_NEED_DEVICE();
  auto context = create_context(watched_options());
  Kernel kernel = scale_kernel(context, 8);
  Kernel moved = std::move(kernel);
  EXPECT_FALSE(kernel);
  context.reset();
  EXPECT_TRUE(moved);
}

TEST(StorageReads, TakeTheOtherBuildOfAShader) {
  ICLK_NEED_DEVICE();
  ContextOptions options = watched_options();
  options.storage_reads = true;
  const auto context = create_context(options);
  EXPECT_TRUE(context->storage_reads());
  MemoryPlan plan;
  const BufferId source = plan.add("source", count * 4, MemoryKind::upload, BufferUse::storage),
                 texels = plan.add("texels", count * 4, MemoryKind::upload, BufferUse::texel, VK_FORMAT_R32_SFLOAT),
                 result = plan.add("result", count * 4, MemoryKind::readback, BufferUse::storage);
  const Workspace memory(context, plan);
  EXPECT_EQ(memory[texels].view, VK_NULL_HANDLE);
  for (uint32_t i = 0; i < count; ++i) {
    memory[source].as<int>()[i] = static_cast<int>(i);
    memory[texels].as<float>()[i] = static_cast<float>(2 * i);
  }
  const Kernel kernel = sum_kernel(context, 64, 3);
  run(context, [&](Recorder& recorder) {
    recorder.dispatch(kernel, {&memory[source], &memory[texels], &memory[result]}, SumPush{5, count}, {groups_for(count, 64)});
    recorder.host_read({&memory[result]});
  });
  for (int i = 0; i < static_cast<int>(count); ++i) ASSERT_EQ(memory[result].as<int>()[i], 9 * i + 5);
}

TEST(StorageReads, RefuseWhatHasNoSuchBuild) {
  ICLK_NEED_DEVICE();
  ContextOptions options = watched_options();
  options.storage_reads = true;
  const auto context = create_context(options);
  const auto message = [&](ShaderCode code, BindingKind kind) -> std::string {
    try {
      Kernel(context, {.name = "sum",
                       .spirv = code,
                       .bindings = {BindingKind::storage_read, kind, BindingKind::storage_write},
                       .push_constant_bytes = sizeof(SumPush),
                       .specialization = {64, 3}});
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::unsupported);
      return e.what();
    }
    return "no error";
  };
  const auto words = sum_comp_spv.texels;
  for (const ShaderCode& code : {ShaderCode(words), ShaderCode(words, words)})  // none, and the same once more
    EXPECT_NE(message(code, BindingKind::texel_read).find("texel buffers are too small"), std::string::npos);
  EXPECT_NE(message(sum_comp_spv, BindingKind::image_read).find("storage texel buffers"), std::string::npos);
}

}  // namespace
}  // namespace iclk::test
