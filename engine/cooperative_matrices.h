#pragma once
#include <array>
#include <cstdint>

namespace iclk::engine {

/// What Context::matrices() is chosen for: tiles of so many rows and columns.
inline constexpr uint32_t kMatrixTile = 16;

/// What a subgroup multiplies at a time: C (m x n, single precision) += A (m x k, halves) B (k x n, halves). All 0: nothing.
struct MatrixSize {
  uint32_t m = 0, n = 0, k = 0;
  explicit operator bool() const { return m > 0; }
  bool operator==(const MatrixSize&) const = default;
};

/// Extensions that cooperative matrices of halves need, all of them. Their features: cooperativeMatrix, shaderFloat16,
/// vulkanMemoryModel and vulkanMemoryModelDeviceScope, which shaders without matrices need as soon as there is the other.
inline constexpr std::array kMatrixExtensions = {"VK_KHR_cooperative_matrix", "VK_KHR_shader_float16_int8",
                                                 "VK_KHR_vulkan_memory_model"};

}  // namespace iclk::engine
