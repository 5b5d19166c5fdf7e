#pragma once
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/device_aligner.h>
#include <iclk/align/device_recording.h>
#include <iclk/refine/refiner.h>
#include <iclk/shaders/refine/refine.h>

namespace iclk {

/// Records alignment and refinement into the application's command buffer: DeviceAligner::record(), then rounds of feature
/// alignment and pose, all on the device. The pose is that of refine_pose() in single precision, with the same loss, whitening,
/// noise floor and rolling shutter test; Refiner, which uses Ceres on the host, is the reference. One thread at a time.
///
/// If AlignerOptions::search is on, rivals of an answer are searched for as in Refiner, but at most ICLK_RIVALS. Not supported:
/// structure, grey values other than luma (Recolouring), features at half the size, and the test whether the depths fit better
/// than a plane.
class DeviceRefiner {
 public:
  /// `aligner` must outlive the refiner and use Solver::device. Makes the kernels, and with a model allocates the grey maps for
  /// feature alignment. Throws Error(invalid_argument) for bad options and for RefinerOptions::structure; Error(unsupported)
  /// for plans of more than ICLK_REFINE_FEATURES features.
  explicit DeviceRefiner(DeviceAligner& aligner, const RefinerOptions& options = {});
  ~DeviceRefiner();

  /// Buffers of one record() call. Must outlive the last execution of the command buffer.
  class Recording {
   public:
    virtual ~Recording() = default;
    /// One shaders::RefinedInfo per pair, visible to later compute shaders and transfers in the command buffer.
    virtual const engine::Buffer& results() const = 0;
    /// The aligned features of the last round: Plan::max_features shaders::AlignedInfo per pair, in the order of the
    /// reference's features. Undefined for pairs whose RefinedInfo::rounds is 0.
    virtual const engine::Buffer& features() const = 0;
    /// The alignment before refinement. It has the features that the device has chosen.
    virtual const DeviceAligner::Recording& alignment() const = 0;
    /// The complete results; RefinedAlignment::stages have no times. Precondition: the submission of the application has
    /// ended. Throws only Error(device_lost).
    virtual std::vector<RefinedAlignment> read() const = 0;
  };

  /// Throws Error(invalid_argument) for more pairs than the plan has.
  std::unique_ptr<Recording> make_recording(int max_pairs = 1);

  /// Records DeviceAligner::record() and the refinement of its results, with the same preconditions and errors.
  void record(Recording& recording, VkCommandBuffer commands, std::span<const DeviceReference> references,
              std::span<const DevicePair> pairs);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
