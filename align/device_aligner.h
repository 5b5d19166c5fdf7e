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

/// The Vulkan solvers: Solver::host (one evaluation a submission, the 6x6 system on the host) and Solver::device (everything in
/// shaders, one submission a batch). The same contract as every Aligner; poses agree with the CPU reference to single
/// precision. One thread at a time; any number of aligners may share a context.
class DeviceAligner : public Aligner {
 public:
  /// Allocates everything. Throws Error(unsupported) if the plan does not fit the device, with the numbers.
  /// With a model its encoder makes the maps, options.levels of its finest levels, and its M-estimator the weights; without,
  /// they are the grey pyramid's and AlignerOptions::robust's. Throws Error(invalid_argument) for a model that does not fit
  /// itself or the options.
  DeviceAligner(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options, Solver solver,
                std::shared_ptr<const Model> model = nullptr);
  ~DeviceAligner() override;

  /// Exactly what the constructor allocates and keeps. Where device memory is not mapped (Context::unified_memory()), a model's
  /// weights pass through as much upload memory besides, which it gives back.
  static engine::MemoryBytes workspace_size(const engine::Context& context, const Plan& plan, const AlignerOptions& options,
                                            Solver solver, const std::shared_ptr<const Model>& model = nullptr);

  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) override;
  using Aligner::align;
  std::vector<Alignment> align(std::span<const Pair> pairs) override;
  void warm_up() override;

  /// align() in two halves: start() takes the pixels, submits and returns, finish() waits and has the results. The device waits
  /// for `synchronisation.wait` before it begins and signals `synchronisation.signal` when it is through: timeline semaphores
  /// of an adopted device. Up to pairs_per_batch() pairs; Solver::device. Between the two align() and start() throw
  /// Error(invalid_argument), and set_reference() waits for the device.
  void start(std::span<const Pair> pairs, const engine::Synchronisation& synchronisation = {});
  bool finished() const;            ///< whether finish() would return at once
  std::vector<Alignment> finish();  ///< nothing where nothing was started

  /// Of a slot whose features the device has chosen, features() and checks() are empty.
  const Camera& camera(int slot) const override;
  const Features& features(int slot) const override;
  const std::vector<FeatureCheck>& checks(int slot) const override;
  const Plan& plan() const override;
  Map grey(int slot) const override;
  int pairs_per_batch() const;  ///< larger spans are split into batches of so many

  /// A recording: descriptors, pair data and results of one record() call. Must outlive the command buffer's last execution.
  class Recording {
   public:
    virtual ~Recording() = default;
    /// shaders::ResultInfo a pair, visible to compute shaders and transfers that follow in the command buffer.
    virtual const engine::Buffer& results() const = 0;
    /// Of a plan with choose_features: shaders::FeatureInfo, Plan::max_features a pair, the features of its reference, visible
    /// like results(). Those that take no part have an inverse depth of 0.
    virtual const engine::Buffer& features() const = 0;
    /// After the application waited for its submission: the same results in full. Throws nothing but Error(device_lost).
    virtual std::vector<Alignment> read() const = 0;
    /// At the same time, the features of each pair's reference. Precondition: a plan with choose_features.
    virtual std::vector<Features> read_features() const = 0;
  };

  /// Allocates a recording for up to `max_pairs` pairs; record() itself allocates nothing on the device.
  std::unique_ptr<Recording> make_recording(int max_pairs = 1);

  /// Writes a whole alignment, references that are given included, into a command buffer in the recording state; submits
  /// nothing. Host data (features, first guesses) are taken now, pixels when the commands execute. Only COMPUTE, TRANSFER and
  /// HOST stages are used. The maps of this aligner are overwritten: what two recordings share is ordered by barriers on one
  /// queue. Precondition: nothing that uses `recording`, or a slot that `references` sets, is pending. Sparse mode only.
  /// Where this throws after its checks, the slots of `references` are not set.
  void record(Recording& recording, VkCommandBuffer commands, std::span<const DeviceReference> references,
              std::span<const DevicePair> pairs);

  const std::shared_ptr<const engine::Context>& context() const;

  /// Device time a stage of all align() calls since clear; empty unless timing was switched on.
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
