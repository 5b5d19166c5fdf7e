#include <iclk/engine/compute/kernel.h>

#include <algorithm>
#include <future>
#include <utility>

#include <iclk/engine/compute/pipelines.h>
#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

/// If no more threads can be started, the waiting thread does the work.
constexpr auto kThreads = std::launch::async | std::launch::deferred;

std::string who_of(const KernelDescription& d) { return std::string("kernel '") + d.name + "': "; }

/// Selects the build of the shader for the context: with texel buffers or with storage buffers.
KernelDescription suited(const Context& context, KernelDescription d) {
  if (!context.storage_reads()) return d;
  if (std::count(d.bindings.begin(), d.bindings.end(), BindingKind::image_read) > 0)
    throw Error(ErrorCode::unsupported, who_of(d) + "needs larger storage texel buffers than " + context.info().name + " has");
  if (std::count(d.bindings.begin(), d.bindings.end(), BindingKind::texel_read) == 0) return d;
  // If both builds are equal, the storage build reads texel buffers too.
  if (d.spirv.storage.empty() || std::ranges::equal(d.spirv.storage, d.spirv.texels))
    throw Error(ErrorCode::unsupported,
                who_of(d) + "has no variant for " + context.info().name + ", whose texel buffers are too small");
  std::replace(d.bindings.begin(), d.bindings.end(), BindingKind::texel_read, BindingKind::storage_read);
  d.spirv.texels = d.spirv.storage;
  return d;
}

void check_description(const Context& context, const KernelDescription& d) {
  const std::string who = who_of(d);
  const VkPhysicalDeviceLimits& limits = context.limits();
  const std::span<const uint32_t> words = d.spirv.texels;
  if (words.size() < 5 || words[0] != 0x07230203u) throw Error(ErrorCode::invalid_argument, who + "the code is not SPIR-V");
  if (d.push_constant_bytes % 4)
    throw Error(ErrorCode::invalid_argument,
                who + std::to_string(d.push_constant_bytes) + " push constant bytes: must be a multiple of 4");
  const auto at_most = [&](const char* limit, uint64_t needs, uint64_t has) {
    if (needs > has)
      throw Error(ErrorCode::unsupported, who + "needs " + std::to_string(needs) + ", " + context.info().name + " has " +
                                              limit + " " + std::to_string(has));
  };
  const auto count = [&](VkDescriptorType type) {
    return std::count_if(d.bindings.begin(), d.bindings.end(), [&](BindingKind kind) { return descriptor_type(kind) == type; });
  };
  at_most("maxPushConstantsSize", d.push_constant_bytes, limits.maxPushConstantsSize);
  at_most("maxPerStageDescriptorStorageBuffers", count(VK_DESCRIPTOR_TYPE_STORAGE_BUFFER),
          limits.maxPerStageDescriptorStorageBuffers);
  at_most("maxPerStageDescriptorUniformBuffers", count(VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER),
          limits.maxPerStageDescriptorUniformBuffers);
  at_most("maxPerStageDescriptorSampledImages",
          count(VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER) + count(VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE),
          limits.maxPerStageDescriptorSampledImages);
  at_most("maxPerStageDescriptorStorageImages", count(VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER),
          limits.maxPerStageDescriptorStorageImages);
  at_most("maxPerStageResources", d.bindings.size(), limits.maxPerStageResources);
}

}  // namespace

VkDescriptorType descriptor_type(BindingKind kind) {
  switch (kind) {
    case BindingKind::texel_read: return VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER;
    case BindingKind::image_read: return VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER;
    case BindingKind::uniform: return VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER;
    case BindingKind::sampled_image: return VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
    default: return VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  }
}

Kernel Kernel::deferred(std::shared_ptr<const Context> context, const KernelDescription& wanted) {
  Kernel kernel;
  kernel.state_ = std::make_shared<State>();
  State& state = *kernel.state_;
  state.context = std::move(context);
  state.name = wanted.name;
  state.description = suited(*state.context, wanted);
  check_description(*state.context, state.description);
  state.description.name = state.name.c_str();
  return kernel;
}

Kernel::Kernel(std::shared_ptr<const Context> context, const KernelDescription& description)
    : Kernel(deferred(std::move(context), description)) {
  made();
}

const Pipeline& Kernel::made() const {
  std::call_once(state_->once,
                 [this] { state_->made = state_->context->pipelines().of(*state_->context, state_->description); });
  return state_->made;
}

std::span<const BindingKind> Kernel::bindings() const { return state_->description.bindings; }
uint32_t Kernel::push_constant_bytes() const { return state_->description.push_constant_bytes; }

void KernelBatch::make() {
  // Check all of them before any is compiled.
  for (const auto& each : wanted_) check_description(*context_, suited(*context_, each.second));
  std::vector<std::pair<Kernel*, std::future<Kernel>>> made;
  for (const auto& each : wanted_)
    made.emplace_back(each.first, std::async(kThreads, [&] { return Kernel(context_, each.second); }));
  std::vector<Kernel> kernels;
  for (auto& [kernel, future] : made) kernels.push_back(future.get());
  for (size_t i = 0; i < made.size(); ++i) *made[i].first = std::move(kernels[i]);
  wanted_.clear();
}

}  // namespace iclk::engine
