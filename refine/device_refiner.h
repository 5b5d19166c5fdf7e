#pragma once
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/device_aligner.h>
#include <iclk/align/device_recording.h>
#include <iclk/refine/refiner.h>
#include <iclk/shaders/refine/refine.h>

namespace iclk {

/// The whole way in the application's command buffer: DeviceAligner::record() and behind it rounds of feature alignment and
/// pose, all on the device. The pose is refine_pose()'s in single precision: the same loss, whitening, estimate of what the
/// positions are off by, and proof of a rolling shutter; Ceres on the host (Refiner) is the reference.
/// Where AlignerOptions::search is on, rivals of an answer are looked for as Refiner does, ICLK_RIVALS at most. Not here:
/// structure, the target in other grey values than luma's (Recolouring), and doubt of depths that fit no better than a plane.
/// One thread at a time.
class DeviceRefiner {
 public:
  /// `aligner` must outlive the refiner and be of Solver::device. Allocates the kernels, and with a model the grey maps that
  /// feature alignment needs. Throws Error(invalid_argument) for bad options or RefinerOptions::structure, Error(unsupported)
  /// for plans of more than ICLK_REFINE_FEATURES features.
  explicit DeviceRefiner(DeviceAligner& aligner, const RefinerOptions& options = {});
  ~DeviceRefiner();

  /// Buffers of one record() call. Must outlive the command buffer's last execution.
  class Recording {
   public:
    virtual ~Recording() = default;
    /// shaders::RefinedInfo a pair, visible to compute shaders and transfers that follow in the command buffer.
    virtual const engine::Buffer& results() const = 0;
    /// shaders::AlignedInfo: Plan::max_features a pair, the reference's in order; the last round's. Of a pair whose
    /// RefinedInfo::rounds is 0 they mean nothing.
    virtual const engine::Buffer& features() const = 0;
    /// The alignment that is refined: for the features of references in which the device has chosen them.
    virtual const DeviceAligner::Recording& alignment() const = 0;
    /// After the application waited for its submission: the same results in full. RefinedAlignment::stages have no times.
    /// Throws nothing but Error(device_lost).
    virtual std::vector<RefinedAlignment> read() const = 0;
  };

  /// Throws Error(invalid_argument) beyond the plan's pairs.
  std::unique_ptr<Recording> make_recording(int max_pairs = 1);

  /// DeviceAligner::record() and the refinement of what it finds; the same contract, and the same that throws.
  void record(Recording& recording, VkCommandBuffer commands, std::span<const DeviceReference> references,
              std::span<const DevicePair> pairs);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
