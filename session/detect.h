#pragma once
#include <cstdint>
#include <string>

#include <iclk/align/features.h>
#include <iclk/align/image.h>

namespace iclk {

enum class Detector {
  shi_tomasi,  ///< the best corners of a grid of buckets, so that they spread over the image
  grid,        ///< even spacing
  random,      ///< uniform, as in the paper
};

struct DetectorOptions {
  Detector detector = Detector::shi_tomasi;
  int count = 200;    ///< the paper has 50; docs/results/design.md compares both
  uint64_t seed = 0;  ///< of `random`
  int border = 17;    ///< px: 2 P + 1 for the paper's 8x8 patches; at most a quarter of the image's shorter side is kept free

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Throws Error(invalid_argument) for another name than shi-tomasi, grid, random.
Detector parse_detector(const std::string& name);

/// At most `count` features of the reference image, at whole pixels with depth. The same input gives the same features, on any
/// machine, and from the command as from Python.
///
/// Places whose 8x8 patch has depth throughout and within 5 % come first: at a depth edge one depth cannot hold for the patch.
/// Where these do not suffice, any pixel with depth and a border around it serves; where there is none, the result is short or
/// empty. An image without any texture is given the grid's features, whatever the detector: that no pose can be had from it is
/// the aligner's to say.
///
/// `depth`: r32f metres of the same size; 0, negative and not finite: none. `seen`: r8, 0 = not really seen (border of an
/// undistorted image), or empty. Throws Error(invalid_argument) for sizes that differ.
Features detect_features(const ImageView& image, const ImageView& depth, const ImageView& seen, const DetectorOptions& options);

}  // namespace iclk
