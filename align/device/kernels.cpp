#include <iclk/align/device/kernels.h>

#include "agreement.comp.spv.h"
#include "choose.comp.spv.h"
#include "chosen.comp.spv.h"
#include "enable.comp.spv.h"
#include "inverse_depth.comp.spv.h"
#include "iterate.comp.spv.h"
#include "jacobian.comp.spv.h"
#include "lm_step.comp.spv.h"
#include "mask.comp.spv.h"
#include "normal_equations.comp.spv.h"
#include "residual.comp.spv.h"
#include "result.comp.spv.h"
#include "weights.comp.spv.h"

namespace iclk::internal {

Kernels::Kernels(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options, Solver solver,
                 const Layout& layout, const WorkgroupSizes& sizes) {
  using enum engine::BindingKind;
  using namespace shaders;
  const uint32_t photometric = options.photometric, adaptive = options.damping == Damping::adaptive, weighted = layout.weighted,
                 robust = static_cast<uint32_t>(options.robust), masked = plan.target_masks;
  engine::KernelBatch batch(context);
  // Only kernels that this plan needs: the device solver splits levels with too many elements for one workgroup.
  const bool on_device = solver == Solver::device, split = !on_device || layout.most_elements() > sizes.fused_elements;
  const auto add = [&](bool needed, engine::Kernel& kernel, const engine::KernelDescription& description) {
    if (needed) batch.add(kernel, description);
  };
  if (plan.target_masks) target_masks = {context, plan, layout, sizes.map};
  if (!layout.learned) pyramid = {context, plan.format, layout, sizes.map};
  if (plan.dense)
    batch.add(inverse_depth,
              {"mask", inverse_depth_comp_spv, {storage_read, storage_read_write}, sizeof(JacobianPush), {sizes.map}});
  else
    batch.add(mask, {"mask",
                     mask_comp_spv,
                     {storage_read, storage_read, storage_read, storage_read, storage_read, storage_write},
                     sizeof(MaskPush),
                     {sizes.map, plan.max_features > 32767}});
  if (plan.choose_features) {
    batch.add(choose, {"choose",
                       choose_comp_spv,
                       {texel_read, sampled_image, storage_write},
                       sizeof(ChoosePush),
                       {0, shader_format(plan.format)}});
    batch.add(chosen, {"choose", chosen_comp_spv, {storage_read_write, storage_read}, sizeof(ChosenPush), {}});
    batch.add(enable, {"choose", enable_comp_spv, {storage_read, storage_read_write}, sizeof(ChosenPush), {}});
  }
  batch.add(jacobian, {"jacobian",
                       jacobian_comp_spv,
                       {storage_read, storage_read, storage_read, texel_read, storage_write, storage_write},
                       sizeof(JacobianPush),
                       {sizes.map, plan.dense}});
  if (options.robust != Robust::unit) {
    add(split, residual,
        {"residual",
         residual_comp_spv,
         {storage_read, storage_read, storage_read, texel_read, texel_read, texel_read, storage_write, storage_read},
         sizeof(IteratePush),
         {sizes.iterate, 0, 0, weighted, 0, masked}});
    add(split, weights,
        {"weights",
         weights_comp_spv,
         {storage_read, storage_read, storage_read_write, storage_read_write},
         sizeof(IteratePush),
         {sizes.weights, 4 * sizes.iterate, 0, 0, robust}});
  }
  add(split, normal_equations,
      {"normal_equations",
       normal_equations_comp_spv,
       {storage_read, storage_read, storage_read, texel_read, texel_read, texel_read, storage_read, storage_read,
        storage_write},
       sizeof(IteratePush),
       {sizes.iterate, photometric, adaptive, weighted, 0, masked}});
  add(on_device && split, lm_step,
      {"lm_step",
       lm_step_comp_spv,
       {storage_read, storage_read, storage_read, storage_read, storage_read_write, storage_write},
       sizeof(IteratePush),
       {0, photometric, adaptive}});
  add(on_device, iterate,
      {"iterate",
       iterate_comp_spv,
       {storage_read, storage_read, storage_read, texel_read, texel_read, texel_read, storage_read_write, storage_read_write,
        storage_write},
       sizeof(IteratePush),
       {sizes.iterate, photometric, adaptive, weighted, robust, masked}});
  batch.add(agreement, {"agreement",
                        agreement_comp_spv,
                        {storage_read, storage_read, storage_read, texel_read, texel_read, texel_read, storage_read,
                         storage_read, storage_write},
                        sizeof(IteratePush),
                        {sizes.iterate, photometric, adaptive, weighted, 0, masked}});
  add(on_device, result,
      {"result",
       result_comp_spv,
       {storage_read, storage_read, storage_read, storage_read_write, storage_write},
       sizeof(ResultPush),
       {}});
  batch.make();
}

}  // namespace iclk::internal
