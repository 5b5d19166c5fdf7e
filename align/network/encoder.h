#pragma once
#include <array>
#include <memory>
#include <optional>
#include <span>

#include <iclk/align/network/feature_maps.h>
#include <iclk/align/network/tiling.h>

namespace iclk::internal {

/// The encoder of a model on a device: raw pixels -> one map a level, in the layout of the grey pyramid, whose place it takes.
/// The maps of each image are the same bits in every batch.
class Encoder {
 public:
  /// Arithmetic only: adds its buffers to `memory`. The `layout.levels.size()` finest levels of the model are computed, for up
  /// to `most_images` images at a time. `variant`: of every layer, in place of choose_variant(). An image that needs more than
  /// `most_bytes` a buffer for its activations goes through in tiles. Precondition: the model has so many levels.
  /// Throws Error(unsupported): see Tiling.
  Encoder(const engine::Context& context, std::shared_ptr<const Model> model, const Layout& layout, const Plan& plan,
          uint32_t most_images, engine::MemoryPlan& memory, std::optional<ConvVariant> variant = {},
          uint64_t most_bytes = kActivationBytes);

  /// Makes the kernels and writes the weights. `memory` is a workspace of that plan.
  void load(std::shared_ptr<const engine::Context> context, const engine::Workspace& memory);

  /// Images first .. first + count - 1 of `pixels`, whose maps have the same numbers.
  struct Images {
    const engine::Buffer* pixels;
    const engine::Buffer* maps;
    uint32_t first, count;
  };
  /// Precondition: load(). Wherever they lie, as many of the images go through together as a pass holds.
  void record(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Images> all) const;

  /// Room for `sources` pairs of buffers (pixels, maps).
  void add_to(engine::ArenaSize& size, uint32_t sources) const;

  uint32_t images_per_pass() const { return pass_; }
  const Tiling& tiling() const { return tiling_; }

 private:
  struct Level {
    std::vector<ConvStep> steps;  // of a tile
    shaders::LevelInfo info;      // of the image
    // What lies in either buffer in turn, with the most channels; in the other one none where its only tensor is reduced. All
    // layers of a level have the same planes, so their borders are written once.
    TensorLayout borders[2];
  };
  bool by_image() const { return model_->normalisation == Normalisation::image; }
  /// Images of a pass, the first of which is its image `at`.
  struct Part : Images {
    uint32_t at;
  };
  /// Mean and deviation of the images of a pass.
  void record_light(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Part> parts) const;
  /// Of a tile.
  MapPlace map_place(const shaders::LevelInfo& info, size_t level, const Tiling::Span& column, const Tiling::Span& row) const;
  /// Texels of the two buffers between which activations go to and fro, of so many images.
  std::array<uint64_t, 2> activation_texels() const;
  /// One tile of each image of a pass.
  void record_tile(engine::Recorder& recorder, const engine::Workspace& memory, std::span<const Part> parts,
                   const Tiling::Span& column, const Tiling::Span& row) const;

  std::shared_ptr<const Model> model_;
  PixelFormat format_;
  // Lanes of a workgroup of normalise.comp, and pixels of each: lavapipe reads what they share in the time that many take.
  struct Normalising {
    uint32_t lanes, pixels;
  } normalising_;
  uint32_t row_pixels_, pixel_words_, map_stride_;
  Tiling tiling_;
  std::vector<Level> levels_;
  uint32_t pass_ = 1;
  engine::BufferId activations_[2], weights_, scratch_;
  engine::BufferId moments_, light_;  // of the images of a pass, where the model normalises by the image
  engine::Kernel image_moments_, image_light_, normalise_;
  std::optional<ConvKernels> convolutions_;
  std::optional<FeatureMaps> feature_maps_;
};

}  // namespace iclk::internal
