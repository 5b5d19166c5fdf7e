// Devices that cannot run every variant of a convolution: a driver between iclk and the real one that fails where it is told
// to.
#include <mutex>
#include <optional>
#include <set>

#include <iclk/align/network/layer_times.h>
#include <iclk/engine/error.h>

#include "host_application.h"

namespace iclk::test {
namespace {

// Which call fails, counted from zero, and with what; negative: none. `ever`: all from there on.
struct Fault {
  int at = -1;
  VkResult result = VK_ERROR_OUT_OF_DEVICE_MEMORY;
  bool ever = false;
  int calls = 0;
  bool now() {
    const int call = calls++;
    return at >= 0 && (call == at || (ever && call > at));
  }
};

struct Driver {
  static inline PFN_vkGetInstanceProcAddr next_instance = nullptr;
  static inline PFN_vkGetDeviceProcAddr next_device = nullptr;
  static inline PFN_vkCreateComputePipelines next_pipelines = nullptr;
  static inline PFN_vkQueueSubmit next_submit = nullptr;
  static inline Fault pipelines, submits;
  static inline std::mutex mutex;  // pipelines are made side by side

  static VKAPI_ATTR VkResult VKAPI_CALL create_pipelines(VkDevice device, VkPipelineCache cache, uint32_t count,
                                                         const VkComputePipelineCreateInfo* infos,
                                                         const VkAllocationCallbacks* callbacks, VkPipeline* made) {
    {
      const std::lock_guard lock(mutex);
      if (pipelines.now()) {
        std::fill_n(made, count, VkPipeline(VK_NULL_HANDLE));
        return pipelines.result;
      }
    }
    return next_pipelines(device, cache, count, infos, callbacks, made);
  }
  static VKAPI_ATTR VkResult VKAPI_CALL submit(VkQueue queue, uint32_t count, const VkSubmitInfo* infos, VkFence fence) {
    return submits.now() ? submits.result : next_submit(queue, count, infos, fence);
  }
  static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_proc(VkDevice device, const char* name) {
    const PFN_vkVoidFunction found = next_device(device, name);
    if (std::string(name) == "vkCreateComputePipelines") {
      next_pipelines = reinterpret_cast<PFN_vkCreateComputePipelines>(found);
      return reinterpret_cast<PFN_vkVoidFunction>(create_pipelines);
    }
    if (std::string(name) != "vkQueueSubmit") return found;
    next_submit = reinterpret_cast<PFN_vkQueueSubmit>(found);
    return reinterpret_cast<PFN_vkVoidFunction>(submit);
  }
  static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL instance_proc(VkInstance instance, const char* name) {
    const PFN_vkVoidFunction found = next_instance(instance, name);
    if (std::string(name) != "vkGetDeviceProcAddr") return found;
    next_device = reinterpret_cast<PFN_vkGetDeviceProcAddr>(found);
    return reinterpret_cast<PFN_vkVoidFunction>(device_proc);
  }
};

class TuningFailures : public testing::Test {
 protected:
  void SetUp() override {
    ICLK_NEED_DEVICE();
    app_.emplace();
    Driver::next_instance = app_->instance.get_instance_proc_addr();
    begin_anew();
    Driver::pipelines = Driver::submits = {};
  }
  /// With a context that has made no pipeline yet.
  void begin_anew() {
    HostDevice host = app_->handed_over();
    host.get_instance_proc_addr = Driver::instance_proc;
    context_ = adopt_device(host);
  }
  void TearDown() override { Driver::pipelines = Driver::submits = {}; }

  static std::vector<ConvVariant> run(const LayerTimes& times) {
    std::vector<ConvVariant> variants;
    for (const LayerTimes::Way& way : times.ways) variants.push_back(way.variant);
    return variants;
  }
  /// What this device can run at all.
  std::vector<ConvVariant> usable() const {
    std::vector<ConvVariant> variants(std::begin(kConvVariants), std::end(kConvVariants));
    if (context_->storage_reads()) std::erase(variants, ConvVariant::winograd4);
    return variants;
  }
  LayerTimes time() const { return time_layers(context_, {kShape}, 2).front(); }
  /// Nothing where it succeeds.
  std::optional<ErrorCode> refusal() const {
    try {
      tune(context_, {kShape});
      return {};
    } catch (const Error& error) {
      return error.code();
    }
  }

  static constexpr ConvShape kShape{8, 16, 2, 24, 20, true};
  std::optional<Application> app_;
  std::shared_ptr<Context> context_;
};

TEST_F(TuningFailures, APipelineThatCannotBeBuiltCostsItsVariantAlone) {
  const LayerTimes all = time();
  EXPECT_EQ(run(all), usable());
  const size_t never = all.dropped.size();
  const int made = Driver::pipelines.calls;
  std::set<ConvVariant> dropped;
  int shared = 0;
  for (int at = 0; at < made; ++at) {
    begin_anew();
    Driver::pipelines = {at, at % 2 ? VK_ERROR_OUT_OF_DEVICE_MEMORY : VK_ERROR_UNKNOWN};
    try {
      const LayerTimes times = time();
      ASSERT_EQ(times.ways.size(), usable().size() - 1) << at;
      ASSERT_EQ(times.dropped.size(), never + 1) << at;
      for (const LayerTimes::Dropped& one : times.dropped) {
        EXPECT_EQ(times.way(one.variant), nullptr);
        EXPECT_NE(one.why, "");
        dropped.insert(one.variant);
      }
    } catch (const Error&) {
      ++shared;  // what makes maps of every variant's output
    }
  }
  EXPECT_EQ(dropped.size(), std::size(kConvVariants));
  EXPECT_LE(shared, 3);
}

TEST_F(TuningFailures, AVariantThatCannotBeRunIsDropped) {
  const size_t never = time().dropped.size();
  const int all = Driver::submits.calls;
  int dropped = 0;
  for (int at = all - 1; at >= 0; at -= 3) {  // some of the runs that count and of the first ones
    Driver::submits = {at};
    try {
      const LayerTimes times = time();
      EXPECT_EQ(times.ways.size(), usable().size() - 1) << at;
      ASSERT_EQ(times.dropped.size(), never + 1) << at;
      ++dropped;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::out_of_memory);  // what fills the common input
    }
  }
  EXPECT_GE(dropped, static_cast<int>(usable().size()));
}

TEST_F(TuningFailures, TheErrorIsThrownWhereNothingIsLeft) {
  Driver::pipelines = {3, VK_ERROR_UNKNOWN, true};  // behind those of the maps
  EXPECT_EQ(refusal(), ErrorCode::vulkan);
  Driver::pipelines = {};
  Driver::submits = {1, VK_ERROR_OUT_OF_HOST_MEMORY, true};
  EXPECT_EQ(refusal(), ErrorCode::out_of_memory);
  Driver::submits = {};
  EXPECT_EQ(refusal(), std::nullopt);
}

TEST_F(TuningFailures, ALostDeviceEndsIt) {
  time();
  const int all = Driver::submits.calls;
  for (int at : {1, all / 2, all - 1}) {
    Driver::submits = {at, VK_ERROR_DEVICE_LOST};
    EXPECT_EQ(refusal(), ErrorCode::device_lost) << at;
  }
}

}  // namespace
}  // namespace iclk::test
