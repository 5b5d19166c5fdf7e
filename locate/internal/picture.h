#pragma once
#include <optional>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/image.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/render/renderer.h>

namespace iclk::internal {

/// `mask`: r8 of the image's size, or empty.
struct Picture {
  ImageView image, mask;
  Camera camera;
};

/// A picture of 2^level x 2^level means, and its pixels. The mask is 0 where a mean has a hidden pixel.
struct SmallPicture {
  Pyramid grey;
  std::vector<uint8_t> hidden;
  Picture picture;

  SmallPicture(const Picture& full, int level);
};

ImageView view_of(const Map& map);

/// m; nothing if the view shows no ground.
std::optional<double> median_depth(const View& view);

/// px: how far T moves the corners of an image whose pixels are at this distance, the most of the four.
double motion(const Camera& camera, const SE3& T, double distance);

}  // namespace iclk::internal
