#pragma once
#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

#include "apps/embed/resources.h"

namespace embed {

/// The application's own drawing: a compute shader that reads iclk's result buffer on the device and marks the features in two
/// images (marks.comp).
class Marks {
 public:
  /// `results`: of the recording, a shaders::RefinedInfo; `features`: of its alignment, so many shaders::FeatureInfo.
  Marks(Host& host, VkBuffer results, VkBuffer features, uint32_t feature_count, const Image& reference, const Image& target);
  ~Marks();
  Marks(const Marks&) = delete;
  Marks& operator=(const Marks&) = delete;

  /// Both images are in GENERAL, results and features visible to compute shaders. Waits for earlier copies. `T_10`: the truth,
  /// for the rings.
  void record(VkCommandBuffer commands, const iclk::Camera& camera, const iclk::SE3& T_10);

 private:
  Marks(Host& host, uint32_t feature_count, const Image& reference, const Image& target);
  void create_pipeline();
  void create_sets(VkBuffer results, VkBuffer features);

  Host& host_;
  const Image* images_[2];
  uint32_t feature_count_;
  VkDescriptorSetLayout set_layout_ = VK_NULL_HANDLE;
  VkPipelineLayout layout_ = VK_NULL_HANDLE;
  VkPipeline pipeline_ = VK_NULL_HANDLE;
  VkDescriptorPool pool_ = VK_NULL_HANDLE;
  VkDescriptorSet sets_[2] = {};
};

}  // namespace embed
