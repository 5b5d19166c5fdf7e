#pragma once
#include <limits>
#include <variant>

#include <iclk/align/aligner.h>
#include <iclk/align/tuning.h>
#include <iclk/engine/memory.h>
#include <iclk/engine/recorder.h>
#include <iclk/engine/timing.h>

namespace iclk {

namespace internal {
struct DeviceParts;
}

/// A target or reference that lies in a buffer of the application: pixels of the plan's format, `row_pixels` from a row to the
/// next.
struct DeviceBufferImage {
  VkBuffer buffer = VK_NULL_HANDLE;
  VkDeviceSize size = 0;    ///< of the buffer, bytes
  VkDeviceSize offset = 0;  ///< of the first pixel, a multiple of 4
  uint32_t row_pixels = 0;  ///< 0: rows are packed
};

/// A target or reference that the application samples: any mip, layer or plane, of any format that can be fetched as floats
/// (R16, RG8, RGBA16F, the luma plane of NV12, ...), read without a copy. Before the alignment the image is in `layout` and
/// visible to reads of compute shaders; an sRGB view gives linear values, which are not what the method expects: make a UNORM
/// one.
struct DeviceImageView {
  VkImageView view = VK_NULL_HANDLE;  ///< 2D, of an image with VK_IMAGE_USAGE_SAMPLED_BIT, one sample, colour
  VkImageLayout layout = VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL;
  uint32_t width = 0, height = 0;  ///< of the view's mip level: the plan's
  bool grey = false;               ///< the first channel is the grey value; else red, green, blue are colours
};

/// An image on the device: a view, or a VkImage (format = the plan's: R8_UNORM, R8G8B8A8_UNORM, B8G8R8A8_UNORM or their SRGB
/// twins, R32_SFLOAT, R32G32B32A32_SFLOAT) or a VkBuffer, which are copied on the device when the commands execute. Never freed
/// or kept by us.
using DeviceImage = std::variant<engine::ForeignImage, DeviceBufferImage, DeviceImageView>;

/// Depth along the optical axis for every pixel of a reference, as the application rendered it: of a texel d, scale d + offset
/// is the depth, or with `inverse` its inverse. What is not positive and finite is no depth.
struct DeviceDepth {
  DeviceImageView view;  ///< its first channel; also the depth aspect of a depth format
  bool inverse = false;
  float scale = 1, offset = 0;
  float background = std::numeric_limits<float>::quiet_NaN();  ///< a texel of this value is no depth either

  /// A depth buffer of a perspective projection in which depths of z0 have the value 0 and those of z1 the value 1, which may
  /// be the nearer one, or infinite. What has the value of the farther one is background.
  static DeviceDepth projected(const DeviceImageView& view, float z0, float z1);
};

struct DeviceReference {
  int slot = 0;
  DeviceImage image;
  Camera camera;
  Features features;  ///< none where there is a depth image
  /// The device chooses features in the image where this has depth, one in each of up to Plan::max_features cells that cover
  /// it: the pixel with the most texture, at depth edges only where the cell has nothing else. Needs Plan::choose_features.
  std::optional<DeviceDepth> depth = {};
};

struct DevicePair {
  int reference = 0;
  DeviceImage target;
  SE3 T_10;
  std::optional<PosePrior> prior;
  bool search = true;  ///< as Pair's
  /// As Pair's, in the first channel of an image of the plan's size; takes the place of the target's alpha.
  std::optional<DeviceImageView> target_mask = {};
};

/// The Vulkan solvers: Solver::host (one evaluation a submission, the 6x6 system on the host) and Solver::device (everything in
/// shaders, one submission a batch). The same contract as every Aligner; poses agree with the CPU reference to single
/// precision. One thread at a time; any number of aligners may share a context.
class DeviceAligner : public Aligner {
 public:
  /// Allocates everything. Throws Error(unsupported) if the plan does not fit the device, with the numbers.
  /// With a model its encoder makes the maps, options.levels of its finest levels, and its M-estimator the weights; without,
  /// they are the grey pyramid's and AlignerOptions::robust's. Throws Error(invalid_argument) for a model that does not fit
  /// itself or the options. `tuning`: which variant computes which layer (tune()); where it does not say, usual_variant().
  DeviceAligner(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options, Solver solver,
                std::shared_ptr<const Model> model = nullptr, const Tuning& tuning = {});
  ~DeviceAligner() override;

  /// Exactly what the constructor allocates and keeps. Where device memory is not mapped (Context::unified_memory()), a model's
  /// weights pass through as much upload memory besides, which it gives back.
  static engine::MemoryBytes workspace_size(const engine::Context& context, const Plan& plan, const AlignerOptions& options,
                                            Solver solver, const std::shared_ptr<const Model>& model = nullptr,
                                            const Tuning& tuning = {});

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
                                                   std::shared_ptr<const Model> model = nullptr, const Tuning& tuning = {});

}  // namespace iclk
