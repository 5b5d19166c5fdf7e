#include "apps/embed/marks.h"

#include <algorithm>

#include <iclk/align/alignment.h>
#include <iclk/engine/result.h>
#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

#include "apps/embed/marks_layout.glsl"
#include "marks.comp.spv.h"

namespace embed {
namespace {

using iclk::engine::check;

static_assert(static_cast<uint32_t>(iclk::Status::converged) == EMBED_CONVERGED);

constexpr VkDescriptorType kBindings[] = {VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
                                          VK_DESCRIPTOR_TYPE_STORAGE_BUFFER};

}  // namespace

Marks::Marks(Host& host, uint32_t feature_count, const Image& reference, const Image& target)
    : host_(host), images_{&reference, &target}, feature_count_(feature_count) {}

Marks::Marks(Host& host, VkBuffer results, VkBuffer features, uint32_t feature_count, const Image& reference,
             const Image& target)
    : Marks(host, feature_count, reference, target) {
  create_pipeline();
  create_sets(results, features);
}

void Marks::create_pipeline() {
  VkDescriptorSetLayoutBinding bindings[3]{};
  for (uint32_t i = 0; i < 3; ++i) bindings[i] = {i, kBindings[i], 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
  const VkDescriptorSetLayoutCreateInfo set{VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO, nullptr, 0, 3, bindings};
  check(vkCreateDescriptorSetLayout(host_.device, &set, nullptr, &set_layout_), "vkCreateDescriptorSetLayout");
  const VkPushConstantRange push{VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof(MarksPush)};
  const VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO, nullptr, 0, 1, &set_layout_, 1, &push};
  check(vkCreatePipelineLayout(host_.device, &layout, nullptr, &layout_), "vkCreatePipelineLayout");
  const VkShaderModuleCreateInfo code{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, nullptr, 0, sizeof marks_comp_spv,
                                      marks_comp_spv};
  VkShaderModule module = VK_NULL_HANDLE;
  check(vkCreateShaderModule(host_.device, &code, nullptr, &module), "vkCreateShaderModule");
  VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
  info.stage = {
      VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO, nullptr, 0, VK_SHADER_STAGE_COMPUTE_BIT, module, "main", nullptr};
  info.layout = layout_;
  const VkResult result = vkCreateComputePipelines(host_.device, VK_NULL_HANDLE, 1, &info, nullptr, &pipeline_);
  vkDestroyShaderModule(host_.device, module, nullptr);
  check(result, "vkCreateComputePipelines");
}

void Marks::create_sets(VkBuffer results, VkBuffer features) {
  const VkDescriptorPoolSize sizes[] = {{VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, 2}, {VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 4}};
  const VkDescriptorPoolCreateInfo pool{VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO, nullptr, 0, 2, 2, sizes};
  check(vkCreateDescriptorPool(host_.device, &pool, nullptr, &pool_), "vkCreateDescriptorPool");
  const VkDescriptorSetLayout layouts[] = {set_layout_, set_layout_};
  const VkDescriptorSetAllocateInfo two{VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO, nullptr, pool_, 2, layouts};
  check(vkAllocateDescriptorSets(host_.device, &two, sets_), "vkAllocateDescriptorSets");
  const VkDescriptorBufferInfo buffers[] = {{results, 0, sizeof(iclk::shaders::RefinedInfo)},
                                            {features, 0, sizeof(iclk::shaders::FeatureInfo) * feature_count_}};
  for (size_t i = 0; i < 2; ++i) {
    const VkDescriptorImageInfo image{VK_NULL_HANDLE, images_[i]->view, VK_IMAGE_LAYOUT_GENERAL};
    VkWriteDescriptorSet writes[3];
    for (uint32_t b = 0; b < 3; ++b)
      writes[b] = {VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET, nullptr, sets_[i], b, 0, 1, kBindings[b], b == 0 ? &image : nullptr,
                   b == 0 ? nullptr : &buffers[b - 1],     nullptr};
    vkUpdateDescriptorSets(host_.device, 3, writes, 0, nullptr);
  }
}

Marks::~Marks() {
  vkDestroyDescriptorPool(host_.device, pool_, nullptr);
  vkDestroyPipeline(host_.device, pipeline_, nullptr);
  vkDestroyPipelineLayout(host_.device, layout_, nullptr);
  vkDestroyDescriptorSetLayout(host_.device, set_layout_, nullptr);
}

void Marks::record(VkCommandBuffer commands, const iclk::Camera& camera, const iclk::SE3& T_10) {
  MarksPush push{static_cast<float>(camera.fx),
                 static_cast<float>(camera.fy),
                 static_cast<float>(camera.cx),
                 static_cast<float>(camera.cy),
                 {},
                 0,
                 0};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) push.true_pose[4 * i + j] = static_cast<float>(T_10.R(i, j));
    push.true_pose[4 * i + 3] = static_cast<float>(T_10.t(i));
  }
  push.thickness = static_cast<uint32_t>(std::max(1, camera.width / 320));
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_);
  for (uint32_t i = 0; i < 2; ++i) {
    images_[i]->record_before_drawing(commands);
    push.target = i;
    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout_, 0, 1, &sets_[i], 0, nullptr);
    vkCmdPushConstants(commands, layout_, VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof push, &push);
    vkCmdDispatch(commands, feature_count_, 1, 1);
  }
}

}  // namespace embed
