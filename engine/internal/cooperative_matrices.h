#pragma once
// What a device's cooperative matrices can do, and how they are enabled.
#include <iclk/engine/cooperative_matrices.h>
#include <iclk/engine/requirements.h>
#include <iclk/engine/vulkan_functions.h>

namespace iclk::engine {

/// The largest size that the device has for compute shaders and that divides kMatrixTile in all three; nothing where it lacks
/// an extension or a feature.
MatrixSize matrix_size(PFN_vkGetInstanceProcAddr get, VkInstance instance, VkPhysicalDevice device,
                       const DeviceCapabilities& capabilities);

/// Those features, to be chained before what a VkDeviceCreateInfo or VkPhysicalDeviceFeatures2 has. Does not move.
class MatrixFeatures {
 public:
  explicit MatrixFeatures(VkBool32 on);
  MatrixFeatures(const MatrixFeatures&) = delete;
  MatrixFeatures& operator=(const MatrixFeatures&) = delete;

  void* chain() { return &half_; }
  bool all() const {
    return half_.shaderFloat16 && model_.vulkanMemoryModel && model_.vulkanMemoryModelDeviceScope &&
           matrices_.cooperative_matrix;
  }

 private:
  // VkPhysicalDeviceCooperativeMatrixFeaturesKHR, which the headers of Debian 12 lack.
  struct Matrices {
    VkStructureType type;
    void* next;
    VkBool32 cooperative_matrix, robust_buffer_access;
  };
  VkPhysicalDeviceShaderFloat16Int8Features half_{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES};
  VkPhysicalDeviceVulkanMemoryModelFeatures model_{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES};
  Matrices matrices_{static_cast<VkStructureType>(1000506000), nullptr, VK_FALSE, VK_FALSE};
};

}  // namespace iclk::engine
