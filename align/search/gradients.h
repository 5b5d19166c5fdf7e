#pragma once
#include <optional>
#include <span>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/align/features.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/search/matching.h>

namespace iclk::internal {

/// The directions of the gradients in an image: histograms over small cells, as SIFT has them. They survive what grey values
/// do not: other leaves, crops, snow and light change how bright ground is, but not where it ends.
class Gradients {
 public:
  static constexpr int kDirections = 8;
  /// A patch of side x side cells. The rows of its basis turn the cells into a descriptor.
  struct Patch {
    Patch(int side, int numbers);
    /// These also match where parallax bends large ones: 4 cells, 64 numbers.
    static const Patch& small();
    /// These tell more places apart where seasons differ: 6 cells, 128 numbers.
    static const Patch& large();

    int side;
    Eigen::MatrixXf basis;
  };
  /// Descriptors, one per column: the lowest cosines of the cells and their directions, normalised. Zero without texture.
  using Descriptors = Eigen::MatrixXf;

  /// Cells are `kCell` squares of `scale` x `scale` pixels wide. Hidden, infinite and NaN pixels have no gradient.
  Gradients(Map grey, int scale, int threads);

  int width() const { return width_; }
  int height() const { return height_; }
  /// Of patches around positions in the map, in pixels of the map, as an image shows them that is rolled by `roll` rad. Cells
  /// beyond the border repeat.
  Descriptors describe(const std::vector<Eigen::Vector2d>& centres, const Patch& patch, double roll = 0) const;

 private:
  /// The square root of the mean gradients in each direction, of the cell around a pixel of the map.
  using Cells = Eigen::Array<float, kDirections, Eigen::Dynamic>;
  int width_ = 0, height_ = 0;
  Cells cells_;
};

/// The start of a pair, if enough features agree on one: by small upright patches, else by large ones, else by small ones at
/// the best of all rolls, else near the places where match_lines() puts them. A roll that is certain is also preferred to an
/// upright start that is not. It does not use the pair's first guess. Precondition: the images of the reference and the pair
/// have the size of the reference's camera.
std::optional<SE3> start_by_gradients(const Reference& reference, std::span<const FeatureCheck> checks, const Pair& pair,
                                      int threads);

}  // namespace iclk::internal
