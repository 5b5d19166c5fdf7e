#pragma once
#include <memory>

#include <iclk/align/network/convolution.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

/// The convolutional M-estimator of a model on a device: weights of the elements of a level at the residual with which it
/// starts. It computes 8x8 patches with their receptive fields, or the whole level if patches are so close that this is less
/// work. The values are those of the whole level. Levels must come coarse to fine.
class MEstimator {
 public:
  /// Arithmetic only: adds its buffers to `memory`. Precondition: the model has an M-estimator with matching layers.
  MEstimator(const engine::Context& context, std::shared_ptr<const Model> model, const Layout& layout, const Plan& plan,
             int batch, engine::MemoryPlan& memory);

  /// Makes the kernels and writes the weights. `memory` is a workspace of the plan. `sum_lanes`: WorkgroupSizes::iterate, which
  /// sets the order of the weights.
  void load(std::shared_ptr<const engine::Context> context, const engine::Workspace& memory, uint32_t sum_lanes);

  /// Buffers of the aligner. It reads them all and writes only `weights`.
  struct Buffers {
    const engine::Buffer *levels, *references, *pairs, *features, *template_a, *maps1, *states, *weights;
  };
  /// `features`: the most of any reference; `flags`: ICLK_FLAG_GIVEN or 0. Precondition: load().
  void record(engine::Recorder& recorder, const engine::Workspace& memory, int level, uint32_t pairs, uint32_t features,
              uint32_t flags, const Buffers& buffers) const;
  void add_to(engine::ArenaSize& size) const;

 private:
  struct Layer {
    uint32_t margin;  // how much its output exceeds the piece on every side
    uint32_t dilation, in_planes, out_channels;
    PackedLayer packed;
  };
  // The size of a piece on which the network runs: a patch or a level, without its border.
  struct Size {
    uint32_t width, height;
  };
  static constexpr Size kPatch{ICLK_PATCH, ICLK_PATCH};
  // Texels of activations for even and odd layers of a piece, and texels that kernels read beyond the last piece.
  struct Room {
    uint64_t even = 0, odd = 0, beyond = 0;
  };
  uint32_t rows_of(const Layer& layer, Size piece) const;
  uint32_t patches_per_pair(int level, uint32_t features) const;
  Room room_of(Size piece) const;
  uint32_t pieces_that_fit(Size piece) const;
  uint64_t work_of(Size piece) const;
  void record_pieces(engine::Recorder& recorder, const engine::Workspace& memory, shaders::MEstimatorPush push, uint32_t pairs,
                     const Buffers& buffers) const;
  void record_network(engine::Recorder& recorder, const engine::Workspace& memory, const shaders::MEstimatorPush& push,
                      Size piece, const Buffers& buffers) const;

  std::shared_ptr<const Model> model_;
  std::vector<shaders::LevelInfo> levels_;
  bool dense_, masked_;
  uint32_t max_features_, element_stride_, map_stride_, weight_stride_, prior_origin_ = 0, prior_stride_ = 0, lanes_;
  uint32_t margin_ = 0, pairs_per_pass_ = 1, most_pieces_ = 1;
  Room room_;
  std::vector<Layer> layers_;
  engine::BufferId inputs_[2], residuals_, prior_, corners_, weights_, activations_[2];
  engine::Kernel input_, patch_, weight_;
  // Indices: all rows of a tile or one fewer; eight output channels or one. Only kernels that a layer uses are made.
  engine::Kernel convolutions_[2][2];
};

}  // namespace iclk::internal
