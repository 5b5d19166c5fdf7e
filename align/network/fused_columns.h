#pragma once
#include <array>
#include <span>

#include <iclk/align/network/conv_step.h>
#include <iclk/align/network/map_place.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// winograd4x1 on a CPU (shaders/convolution/winograd4x1_fused.comp), one of the kernels of convolutions. A reduced step makes
/// the level's map itself.
class FusedColumns {
 public:
  static constexpr uint32_t kKernels = 5;
  /// Which of the kernels a step needs, and how it is made.
  static uint32_t kernel_of(const ConvStep& step);
  static engine::KernelDescription description(const ConvStep& step);
  static bool can_reduce(const ConvStep& step);

  engine::Kernel& operator[](uint32_t kernel) { return kernels_[kernel]; }
  void add_to(engine::ArenaSize& size) const;

  /// See ConvKernels::record().
  void record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in, const engine::Buffer& weights,
              const engine::Buffer& out, const engine::Buffer& scratch, const MapPlace& place,
              std::span<const MapPart> parts) const;

 private:
  std::array<engine::Kernel, kKernels> kernels_;
};

}  // namespace iclk::internal
