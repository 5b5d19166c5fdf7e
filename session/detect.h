#pragma once
#include <cstdint>
#include <string>

#include <iclk/align/features.h>
#include <iclk/align/image.h>

namespace iclk {

enum class Detector {
  shi_tomasi,  ///< the best corners of each bucket of a grid, so that they spread over the image
  grid,        ///< even spacing
  random,      ///< uniformly distributed, as in the paper
};

struct DetectorOptions {
  Detector detector = Detector::shi_tomasi;
  int count = 200;    ///< the paper has 50; docs/results/design.md compares both
  uint64_t seed = 0;  ///< for `random`
  int border = 17;    ///< px without features: 2 P + 1 for the paper's 8x8 patches; at most a quarter of the shorter side

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Parses shi-tomasi, grid or random. Throws Error(invalid_argument) for other names.
Detector parse_detector(const std::string& name);

/// Chooses at most `count` features of the reference image, at whole pixels with depth. Equal inputs give equal features, on
/// every machine, in the command and in Python.
///
/// Patches of 8x8 pixels with depth everywhere and differences of at most 5 % are preferred, because one depth must fit the
/// whole patch. If these are too few, any pixel with depth outside the border is used. The result may therefore be short or
/// empty. On an image without texture every detector returns the features of `grid`; the aligner then reports the failure.
///
/// `depth`: r32f metres, of the size of `image`; 0, negative or not finite: unknown. `seen`: r8, 0: not seen by the camera
/// (border of an undistorted image); may be empty. Throws Error(invalid_argument) for different sizes.
Features detect_features(const ImageView& image, const ImageView& depth, const ImageView& seen, const DetectorOptions& options);

}  // namespace iclk
