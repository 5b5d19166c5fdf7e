#pragma once
#include <array>
#include <memory>
#include <optional>
#include <span>

#include <iclk/align/network/feature_maps.h>
#include <iclk/align/network/tiling.h>

namespace iclk::internal {

/// The encoder of a model on a device. It makes one map per level from raw pixels, in the layout of the grey pyramid, which it
/// replaces. The maps of an image are bit-identical in every batch.
class Encoder {
 public:
  /// Arithmetic only: adds its buffers to `memory`. It computes the `layout.levels.size()` finest levels of the model, for up
  /// to `most_images` images at a time. `variant` replaces choose_variant() for all layers. Images are tiled if their
  /// activations need more than `most_bytes` per buffer. Precondition: the model has enough levels. Throws Error(unsupported):
  /// see Tiling.
  Encoder(const engine::Context& context, std::shared_ptr<const Model> model, const Layout& layout, const Plan& plan,
          uint32_t most_images, engine::MemoryPlan& memory, std::optional<ConvVariant> variant = {},
          uint64_t most_bytes = kActivationBytes);

  /// Makes the kernels and writes the weights. `memory` is a workspace of the plan.
  void load(std::shared_ptr<const engine::Context> context, const engine::Workspace& memory);

  /// Images first .. first + count - 1 of `pixels`; their maps have the same numbers in `maps`.
  struct Images {
    const engine::Buffer* pixels;
    const engine::Buffer* maps;
    uint32_t first, count;
  };
  /// Encodes images, images_per_pass() at a time, from several buffers if necessary. Precondition: load().
  void record(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Images> all) const;

  /// Room for `sources` pairs of buffers (pixels, maps).
  void add_to(engine::ArenaSize& size, uint32_t sources) const;

  uint32_t images_per_pass() const { return pass_; }
  const Tiling& tiling() const { return tiling_; }

 private:
  struct Level {
    std::vector<ConvStep> steps;  // of a tile
    shaders::LevelInfo info;      // of the image
    // The layout with the most channels in each of the two alternating buffers; without channels if all tensors of the buffer
    // are reduced. All layers of a level have planes of one size, so their borders are written once.
    TensorLayout borders[2];
  };
  bool by_image() const { return model_->normalisation == Normalisation::image; }
  /// Images of a pass; the first one has index `at` in the pass.
  struct Part : Images {
    uint32_t at;
  };
  /// Mean and deviation of the images of a pass.
  void record_light(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Part> parts) const;
  /// The place of the maps of a tile.
  MapPlace map_place(const shaders::LevelInfo& info, size_t level, const Tiling::Span& column, const Tiling::Span& row) const;
  /// The sizes in texels of the two alternating buffers of activations, for all images of a pass.
  std::array<uint64_t, 2> activation_texels() const;
  /// One tile of each image of a pass.
  void record_tile(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Part> parts,
                   const Tiling::Span& column, const Tiling::Span& row) const;

  std::shared_ptr<const Model> model_;
  PixelFormat format_;
  // Lanes of a workgroup of normalise.comp, and pixels per lane. On lavapipe, reading the shared values takes as long as many
  // pixels.
  struct Normalising {
    uint32_t lanes, pixels;
  } normalising_;
  uint32_t row_pixels_, pixel_words_, map_stride_;
  Tiling tiling_;
  std::vector<Level> levels_;
  uint32_t pass_ = 1;
  engine::BufferId activations_[2], weights_, scratch_;
  engine::BufferId moments_, light_;  // of the images of a pass, with Normalisation::image
  engine::Kernel image_moments_, image_light_, normalise_;
  std::optional<ConvKernels> convolutions_;
  std::optional<FeatureMaps> feature_maps_;
};

}  // namespace iclk::internal
