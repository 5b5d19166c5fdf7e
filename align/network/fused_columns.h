#pragma once
#include <array>
#include <span>

#include <iclk/align/network/conv_step.h>
#include <iclk/align/network/map_place.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// The kernels for winograd4x1 on a CPU (shaders/convolution/winograd4x1_fused.comp). A reduced step also makes the map of the
/// level.
class FusedColumns {
 public:
  static constexpr uint32_t kKernels = 5;
  /// The index of the kernel that a step needs, and its description.
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
