#include <iclk/align/network/cooperative_conv.h>

#include <iclk/engine/error.h>
#include <iclk/shaders/network/network.h>

#include "conv_cooperative.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kSide = ICLK_MATRIX_SIDE;
static_assert(kSide == engine::kMatrixTile);

// Output channels of a workgroup: two matrices where none of them is left empty.
uint32_t channels_of(const ConvStep& step) { return engine::groups_for(step.out.channels, kSide) % 2 == 0 ? 2 * kSide : kSide; }

uint32_t lanes_of(const engine::Context& context) { return ICLK_MATRIX_SUBGROUPS * context.info().subgroup_size; }

}  // namespace

bool CooperativeConv::can_run(const ConvStep& step, const engine::Context& context) {
  constexpr uint32_t kSharedBytes = 32768;
  const VkPhysicalDeviceLimits& limits = context.limits();
  return !conv_cooperative_comp_spv.texels.empty() && context.matrices() && step.dilation <= ICLK_MATRIX_DILATION &&
         limits.maxComputeSharedMemorySize >= kSharedBytes && limits.maxComputeWorkGroupInvocations >= lanes_of(context);
}

uint32_t CooperativeConv::kernel_of(const ConvStep& step) { return channels_of(step) / kSide - 1; }

engine::KernelDescription CooperativeConv::description(const ConvStep& step, const engine::Context& context) {
  if (!can_run(step, context))
    throw Error(ErrorCode::unsupported, "no cooperative matrices for this layer on " + context.info().name);
  return description(step, context, conv_cooperative_comp_spv, context.matrices());
}

engine::KernelDescription CooperativeConv::description(const ConvStep& step, const engine::Context& context,
                                                       const engine::ShaderCode& code, const engine::MatrixSize& size) {
  using enum engine::BindingKind;
  return {"encode",
          code,
          {texel_read, texel_read, storage_write},
          sizeof(shaders::ConvPush),
          {lanes_of(context), channels_of(step), size.m, size.n, size.k}};
}

void CooperativeConv::record(engine::Recorder& recorder, const engine::Kernel& kernel, const ConvStep& step,
                             const engine::Buffer& in, const engine::Buffer& weights, const engine::Buffer& out) {
  shaders::ConvPush push{};
  set_layer(push, step, step.dilation * (step.in.pitch() + 1), step.out);
  const uint32_t rows = ICLK_MATRIX_SUBGROUPS * ICLK_MATRIX_ROWS;
  const uint64_t tiles = static_cast<uint64_t>(engine::groups_for(push.width, kSide)) *
                         engine::groups_for(push.height, rows * push.dilation) * push.dilation * push.images;
  recorder.dispatch(kernel, {&in, &weights, &out}, push,
                    spread(engine::groups_for(step.out.channels, channels_of(step)), tiles, 1));
}

}  // namespace iclk::internal
