#pragma once
#include <iclk/align/device/grey_pyramid.h>
#include <iclk/align/device/target_masks.h>
#include <iclk/engine/compute/kernel.h>

namespace iclk::internal {

/// ICLK_FORMAT_* of a plan's pixel format.
uint32_t shader_format(PixelFormat format);
/// Of a texel buffer of a plan's pixels, a texel each.
VkFormat texel_format(PixelFormat format);

/// The shaders of shaders/, specialised for a plan.
struct Kernels {
  Kernels(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options, Solver solver,
          const Layout& layout, const WorkgroupSizes& sizes);

  GreyPyramid pyramid;
  TargetMasks target_masks;
  engine::Kernel choose, chosen, enable;  // Plan::choose_features
  engine::Kernel mask, inverse_depth, jacobian, residual, weights, normal_equations, lm_step, iterate, agreement, result;
};

}  // namespace iclk::internal
