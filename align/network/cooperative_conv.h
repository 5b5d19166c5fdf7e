#pragma once
#include <iclk/align/network/conv_step.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// `cooperative` (shaders/convolution/conv_cooperative.glsl), one of the kernels of convolutions. Weights are packed as those
/// of `direct`.
class CooperativeConv {
 public:
  static constexpr uint32_t kKernels = 2;

  /// This build has the shader (its compiler knows the extension), the context matrices, and shared memory holds the pixels
  /// of the step's dilation.
  static bool can_run(const ConvStep& step, const engine::Context& context);

  /// Which of the kernels a step needs, and how it is made. `code` computes with matrices of `size`.
  static uint32_t kernel_of(const ConvStep& step);
  static engine::KernelDescription description(const ConvStep& step, const engine::Context& context);
  static engine::KernelDescription description(const ConvStep& step, const engine::Context& context,
                                               const engine::ShaderCode& code, const engine::MatrixSize& size);

  /// See ConvKernels::record().
  static void record(engine::Recorder& recorder, const engine::Kernel& kernel, const ConvStep& step, const engine::Buffer& in,
                     const engine::Buffer& weights, const engine::Buffer& out);
};

}  // namespace iclk::internal
