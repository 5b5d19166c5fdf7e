#pragma once
#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/se3.h>

#include "apps/embed/resources.h"

namespace embed {

/// The application's own drawing: a compute shader that reads iclk's result buffer on the device and marks the features in two
/// images (marks.comp).
class Marks {
 public:
  /// `results`: of the recording, a shaders::RefinedInfo.
  Marks(Host& host, VkBuffer results, const Image& reference, const Image& target, int max_features);
  ~Marks();
  Marks(const Marks&) = delete;
  Marks& operator=(const Marks&) = delete;

  /// Both images are in GENERAL, results visible to compute shaders. Waits for earlier copies. Takes the features now.
  /// `T_10`: the truth, for the rings.
  void record(VkCommandBuffer commands, const iclk::Camera& camera, const iclk::Features& features, const iclk::SE3& T_10);

 private:
  Marks(Host& host, const Image& reference, const Image& target, int max_features);
  void create_pipeline();
  void create_sets(VkBuffer results);

  Host& host_;
  const Image* images_[2];
  Buffer points_;
  VkDescriptorSetLayout set_layout_ = VK_NULL_HANDLE;
  VkPipelineLayout layout_ = VK_NULL_HANDLE;
  VkPipeline pipeline_ = VK_NULL_HANDLE;
  VkDescriptorPool pool_ = VK_NULL_HANDLE;
  VkDescriptorSet sets_[2] = {};
};

}  // namespace embed
