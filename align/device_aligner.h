#pragma once
#include <iclk/align/aligner.h>
#include <iclk/align/model.h>
#include <iclk/engine/context.h>
#include <iclk/engine/resources.h>
#include <iclk/engine/timing.h>

namespace iclk {

namespace internal {
struct DeviceParts;
}

struct DeviceReference;  // device_recording.h
struct DevicePair;

/// The Vulkan solvers: Solver::host (one submission per evaluation, the 6x6 system on the host) and Solver::device (everything
/// in shaders, one submission per batch). Poses agree with the CPU reference to single precision. One thread at a time; any
/// number of aligners may share a context.
class DeviceAligner : public Aligner {
 public:
  /// Allocates all device memory. With a model, the `options.levels` finest levels of its encoder make the maps, and its
  /// M-estimator the weights. Without, the maps are the grey pyramid, and AlignerOptions::robust gives the weights.
  /// Throws Error(unsupported) with the numbers if the plan does not fit the device; Error(invalid_argument) for a model that
  /// is inconsistent or does not fit the options.
  DeviceAligner(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options, Solver solver,
                std::shared_ptr<const Model> model = nullptr);
  ~DeviceAligner() override;

  /// The exact number of bytes that the constructor allocates and keeps. Unless Context::unified_memory(), the constructor also
  /// allocates upload memory of the size of the model's weights, and frees it.
  static engine::MemoryBytes workspace_size(const engine::Context& context, const Plan& plan, const AlignerOptions& options,
                                            Solver solver, const std::shared_ptr<const Model>& model = nullptr);

  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) override;
  using Aligner::align;
  std::vector<Alignment> align(std::span<const Pair> pairs) override;
  void warm_up() override;

  /// align() in two halves: start() copies the pixels, submits and returns; finish() waits and returns the results. The device
  /// waits for `synchronisation.wait` before the work and signals `synchronisation.signal` after it. These are timeline
  /// semaphores of an adopted device. Preconditions: at most pairs_per_batch() pairs, and Solver::device. Before finish(),
  /// align() and start() throw Error(invalid_argument), and set_reference() waits for the device.
  void start(std::span<const Pair> pairs, const engine::Synchronisation& synchronisation = {});
  bool finished() const;            ///< whether finish() would return at once
  std::vector<Alignment> finish();  ///< empty if nothing was started

  const Camera& camera(int slot) const override;
  /// Like checks(), empty for a slot whose features the device has chosen.
  const Features& features(int slot) const override;
  const std::vector<FeatureCheck>& checks(int slot) const override;
  const Plan& plan() const override;
  Map grey(int slot) const override;
  int pairs_per_batch() const;  ///< align() splits larger spans into batches of this size

  /// Descriptors, pair data and results of one record() call. Must outlive the last execution of the command buffer.
  class Recording {
   public:
    virtual ~Recording() = default;
    /// One shaders::ResultInfo per pair, visible to later compute shaders and transfers in the command buffer.
    virtual const engine::Buffer& results() const = 0;
    /// The features of each pair's reference: Plan::max_features shaders::FeatureInfo per pair, visible like results().
    /// Unused entries have an inverse depth of 0. Precondition: a plan with choose_features.
    virtual const engine::Buffer& features() const = 0;
    /// The complete results. Precondition: the submission of the application has ended. Throws only Error(device_lost).
    virtual std::vector<Alignment> read() const = 0;
    /// The features of each pair's reference. Preconditions: as read(), and a plan with choose_features.
    virtual std::vector<Features> read_features() const = 0;
  };

  /// Allocates a recording for up to `max_pairs` pairs; record() itself allocates nothing on the device.
  std::unique_ptr<Recording> make_recording(int max_pairs = 1);

  /// Writes a whole alignment, including the preparation of `references`, into a command buffer in the recording state. It
  /// submits nothing. Host data (features, first guesses) are copied now; pixels are read when the commands execute. Only
  /// COMPUTE, TRANSFER and HOST stages are used. Recordings of one aligner share its maps, so submit them to one queue, where
  /// their barriers order them. Sparse mode only. Precondition: no pending work uses `recording` or a slot in `references`.
  /// If this throws after its checks, the slots of `references` are unset.
  void record(Recording& recording, VkCommandBuffer commands, std::span<const DeviceReference> references,
              std::span<const DevicePair> pairs);

  const std::shared_ptr<const engine::Context>& context() const;

  /// The device time of each stage, summed over all align() calls since timing was switched on; empty if it is off.
  void enable_timing(bool on);
  const std::vector<engine::StageTime>& times() const;

 private:
  friend struct internal::DeviceParts;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Precondition: solver is host or device.
std::unique_ptr<DeviceAligner> make_device_aligner(std::shared_ptr<const engine::Context> context, const Plan& plan,
                                                   const AlignerOptions& options = {}, Solver solver = Solver::host,
                                                   std::shared_ptr<const Model> model = nullptr);

}  // namespace iclk
