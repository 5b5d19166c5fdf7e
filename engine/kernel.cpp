#include <iclk/engine/kernel.h>

#include <algorithm>
#include <cmath>
#include <future>
#include <utility>

#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

std::string who_of(const KernelDescription& d) { return std::string("kernel '") + d.name + "': "; }

/// As the context reads: texel buffers, or storage buffers in their place.
KernelDescription suited(const Context& context, KernelDescription d) {
  if (!context.storage_reads()) return d;
  if (std::count(d.bindings.begin(), d.bindings.end(), BindingKind::image_read) > 0)
    throw Error(ErrorCode::unsupported,
                who_of(d) + "reads storage texel buffers, for which those of " + context.info().name + " are too small");
  if (std::count(d.bindings.begin(), d.bindings.end(), BindingKind::texel_read) == 0) return d;
  // The same words twice: what it was built from reads texel buffers either way.
  if (d.spirv.storage.empty() || std::ranges::equal(d.spirv.storage, d.spirv.texels))
    throw Error(ErrorCode::unsupported,
                who_of(d) + "has no build for " + context.info().name + ", whose texel buffers are too small");
  std::replace(d.bindings.begin(), d.bindings.end(), BindingKind::texel_read, BindingKind::storage_read);
  d.spirv.texels = d.spirv.storage;
  return d;
}

void check_description(const Context& context, const KernelDescription& d) {
  const std::string who = who_of(d);
  const VkPhysicalDeviceLimits& limits = context.limits();
  const std::span<const uint32_t> words = d.spirv.texels;
  if (words.size() < 5 || words[0] != 0x07230203u) throw Error(ErrorCode::invalid_argument, who + "this is not SPIR-V");
  if (d.push_constant_bytes % 4)
    throw Error(ErrorCode::invalid_argument,
                who + std::to_string(d.push_constant_bytes) + " push constant bytes: no multiple of 4");
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

Kernel::Kernel(std::shared_ptr<const Context> context, const KernelDescription& wanted)
    : context_(std::move(context)), name_(wanted.name), push_constant_bytes_(wanted.push_constant_bytes) {
  const KernelDescription description = suited(*context_, wanted);
  bindings_ = description.bindings;
  check_description(*context_, description);
  try {
    create(description);
  } catch (...) {
    destroy();
    throw;
  }
}

void Kernel::create(const KernelDescription& description) {
  const DeviceFunctions& vk = context_->vk();
  const VkDevice device = context_->device();

  std::vector<VkDescriptorSetLayoutBinding> bindings;
  for (BindingKind kind : bindings_)
    bindings.push_back(
        {static_cast<uint32_t>(bindings.size()), descriptor_type(kind), 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr});
  const VkDescriptorSetLayoutCreateInfo set{VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO, nullptr, 0,
                                            static_cast<uint32_t>(bindings.size()), bindings.data()};
  check_made(vk.CreateDescriptorSetLayout(device, &set, nullptr, &set_layout_), set_layout_, "vkCreateDescriptorSetLayout",
             name_);

  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, push_constant_bytes_};
  VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &set_layout_;
  layout.pushConstantRangeCount = push_constant_bytes_ ? 1 : 0;
  layout.pPushConstantRanges = &range;
  check_made(vk.CreatePipelineLayout(device, &layout, nullptr, &layout_), layout_, "vkCreatePipelineLayout", name_);

  std::vector<VkSpecializationMapEntry> entries;
  for (uint32_t i = 0; i < description.specialization.size(); ++i) entries.push_back({i, i * 4, 4});
  const VkSpecializationInfo specialization{static_cast<uint32_t>(entries.size()), entries.data(), entries.size() * 4,
                                            description.specialization.data()};
  const VkShaderModuleCreateInfo code{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, nullptr, 0,
                                      description.spirv.texels.size_bytes(), description.spirv.texels.data()};
  VkShaderModule module = VK_NULL_HANDLE;
  check(vk.CreateShaderModule(device, &code, nullptr, &module), "vkCreateShaderModule", name_);
  VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
  info.stage = {VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO, nullptr, 0, VK_SHADER_STAGE_COMPUTE_BIT, module, "main",
                entries.empty() ? nullptr : &specialization};
  info.layout = layout_;
  // Recorder::dispatch() may have to begin in the middle of a grid.
  if (std::isfinite(context_->longest_submission())) info.flags = VK_PIPELINE_CREATE_DISPATCH_BASE;
  const VkResult result = vk.CreateComputePipelines(device, context_->pipeline_cache(), 1, &info, nullptr, &pipeline_);
  vk.DestroyShaderModule(device, module, nullptr);
  check(result, "vkCreateComputePipelines", name_);
  context_->name_object(VK_OBJECT_TYPE_PIPELINE, reinterpret_cast<uint64_t>(pipeline_), name_);
}

Kernel::~Kernel() { destroy(); }

Kernel::Kernel(Kernel&& other) noexcept { *this = std::move(other); }

Kernel& Kernel::operator=(Kernel&& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(name_, other.name_);
  std::swap(bindings_, other.bindings_);
  std::swap(push_constant_bytes_, other.push_constant_bytes_);
  std::swap(set_layout_, other.set_layout_);
  std::swap(layout_, other.layout_);
  std::swap(pipeline_, other.pipeline_);
  return *this;
}

void Kernel::destroy() noexcept {
  if (!context_) return;
  const DeviceFunctions& vk = context_->vk();
  if (pipeline_) vk.DestroyPipeline(context_->device(), pipeline_, nullptr);
  if (layout_) vk.DestroyPipelineLayout(context_->device(), layout_, nullptr);
  if (set_layout_) vk.DestroyDescriptorSetLayout(context_->device(), set_layout_, nullptr);
}

void KernelBatch::make() {
  // None is compiled where one cannot be had.
  for (const auto& each : wanted_) check_description(*context_, suited(*context_, each.second));
  std::vector<std::pair<Kernel*, std::future<Kernel>>> made;
  for (const auto& each : wanted_)
    made.emplace_back(each.first, std::async(std::launch::async, [&] { return Kernel(context_, each.second); }));
  std::vector<Kernel> kernels;
  for (auto& [kernel, future] : made) kernels.push_back(future.get());
  for (size_t i = 0; i < made.size(); ++i) *made[i].first = std::move(kernels[i]);
  wanted_.clear();
}

}  // namespace iclk::engine
