#pragma once
#include <optional>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/refine/internal/local_contrast.h>

namespace iclk::internal {

/// The motion blur of both images of a pair: each is the mean along a straight line that is centred on the pixel. The lines go
/// from one end to the other, in px of the image that is blurred; zero: sharp.
struct PairBlur {
  Eigen::Vector2d reference = Eigen::Vector2d::Zero(), target = Eigen::Vector2d::Zero();
  /// The same lines in the other image: blurred by them too, both images are blurred alike.
  Eigen::Vector2d reference_in_target = Eigen::Vector2d::Zero(), target_in_reference = Eigen::Vector2d::Zero();
};

/// Finds the motion blur of a pair from the spectra of patches around the features, which T_10 brings into the target. T_10 may
/// be a few pixels off. Nothing if the images are sharp, equally blurred, or do not correlate.
///
/// Each patch is A = K_0 S + noise and B = K_1 S + noise, where S is the sharp texture with the power f^-2.4 and K are the
/// spectra of the lines. The lines are those of largest likelihood for the mean spectra of all patches.
std::optional<PairBlur> find_blur(const Map& f0, const Map& f1, const Camera& camera, const Features& features,
                                  const SE3& T_10);

/// An image blurred along a line; borders are mirrored. It has one channel, or three.
FloatImage blurred(const ImageView& image, const Eigen::Vector2d& line);

/// The mask of an image that is blurred along a line: 0 where a hidden pixel takes part. Empty for an empty mask.
struct BlurredMask {
  std::vector<uint8_t> pixels;
  ImageView view;
};
BlurredMask blurred_mask(const ImageView& mask, const Eigen::Vector2d& line);

}  // namespace iclk::internal
