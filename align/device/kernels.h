#pragma once
#include <iclk/align/device/grey_pyramid.h>
#include <iclk/align/device/target_masks.h>
#include <iclk/engine/compute/kernel.h>

namespace iclk::internal {

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
