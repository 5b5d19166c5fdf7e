#include <iclk/engine/compute/pipelines.h>

#include <cmath>
#include <string_view>

#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

void destroy_one(const DeviceFunctions& vk, VkDevice device, const Pipeline& made) noexcept {
  if (made.pipeline) vk.DestroyPipeline(device, made.pipeline, nullptr);
  if (made.layout) vk.DestroyPipelineLayout(device, made.layout, nullptr);
  if (made.set_layout) vk.DestroyDescriptorSetLayout(device, made.set_layout, nullptr);
}

// If it throws, `made` has the objects made so far.
void make(const Context& context, const KernelDescription& description, Pipeline& made) {
  const DeviceFunctions& vk = context.vk();
  const VkDevice device = context.device();
  const std::string name = description.name;

  std::vector<VkDescriptorSetLayoutBinding> bindings;
  for (BindingKind kind : description.bindings)
    bindings.push_back(
        {static_cast<uint32_t>(bindings.size()), descriptor_type(kind), 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr});
  const VkDescriptorSetLayoutCreateInfo set{VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO, nullptr, 0,
                                            static_cast<uint32_t>(bindings.size()), bindings.data()};
  check_made(vk.CreateDescriptorSetLayout(device, &set, nullptr, &made.set_layout), made.set_layout,
             "vkCreateDescriptorSetLayout", name);

  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, description.push_constant_bytes};
  VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &made.set_layout;
  layout.pushConstantRangeCount = description.push_constant_bytes ? 1 : 0;
  layout.pPushConstantRanges = &range;
  check_made(vk.CreatePipelineLayout(device, &layout, nullptr, &made.layout), made.layout, "vkCreatePipelineLayout", name);

  std::vector<VkSpecializationMapEntry> entries;
  for (uint32_t i = 0; i < description.specialization.size(); ++i) entries.push_back({i, i * 4, 4});
  const VkSpecializationInfo specialization{static_cast<uint32_t>(entries.size()), entries.data(), entries.size() * 4,
                                            description.specialization.data()};
  const VkShaderModuleCreateInfo code{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, nullptr, 0,
                                      description.spirv.texels.size_bytes(), description.spirv.texels.data()};
  VkShaderModule module = VK_NULL_HANDLE;
  check(vk.CreateShaderModule(device, &code, nullptr, &module), "vkCreateShaderModule", name);
  VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
  info.stage = {VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO, nullptr, 0, VK_SHADER_STAGE_COMPUTE_BIT, module, "main",
                entries.empty() ? nullptr : &specialization};
  info.layout = made.layout;
  // Recorder::dispatch() may split a dispatch, which then begins in the middle of the grid.
  if (std::isfinite(context.longest_submission())) info.flags = VK_PIPELINE_CREATE_DISPATCH_BASE;
  const VkResult result = vk.CreateComputePipelines(device, context.pipeline_cache(), 1, &info, nullptr, &made.pipeline);
  vk.DestroyShaderModule(device, module, nullptr);
  check(result, "vkCreateComputePipelines", name);
  context.name_object(VK_OBJECT_TYPE_PIPELINE, reinterpret_cast<uint64_t>(made.pipeline), name);
}

}  // namespace

Pipeline Pipelines::of(const Context& context, const KernelDescription& d) {
  const std::span<const uint32_t> words = d.spirv.texels;
  const std::string_view bytes(reinterpret_cast<const char*>(words.data()), words.size_bytes());
  Key key{d.name,     words.data(),          words.size(),    std::hash<std::string_view>{}(bytes),
          d.bindings, d.push_constant_bytes, d.specialization};
  {
    const std::lock_guard lock(mutex_);
    if (const auto found = made_.find(key); found != made_.end()) return found->second;
  }
  Pipeline made;
  try {
    make(context, d, made);
    const std::lock_guard lock(mutex_);
    const auto [at, is_new] = made_.emplace(std::move(key), made);
    if (!is_new) destroy_one(context.vk(), context.device(), made);
    return at->second;
  } catch (...) {
    destroy_one(context.vk(), context.device(), made);
    throw;
  }
}

void Pipelines::destroy(const DeviceFunctions& vk, VkDevice device) noexcept {
  for (const auto& each : made_) destroy_one(vk, device, each.second);
  made_.clear();
}

}  // namespace iclk::engine
