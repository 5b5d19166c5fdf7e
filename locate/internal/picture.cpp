#include <iclk/locate/internal/picture.h>

#include <algorithm>
#include <cmath>
#include <iterator>

namespace iclk::internal {
namespace {

std::vector<uint8_t> small_mask(const ImageView& mask, int level) {
  const int width = mask.width >> level, height = mask.height >> level;
  std::vector<uint8_t> small(static_cast<size_t>(width) * static_cast<size_t>(height), 255);
  for (int v = 0; v < height << level; ++v) {
    uint8_t* row = small.data() + static_cast<size_t>(v >> level) * static_cast<size_t>(width);
    for (int u = 0; u < width << level; ++u)
      if (mask.row(v)[u] == 0) row[u >> level] = 0;
  }
  return small;
}

}  // namespace

ImageView view_of(const Map& map) { return {map.data.data(), map.width, map.height, 0, PixelFormat::r32f}; }

SmallPicture::SmallPicture(const Picture& full, int level) : picture(full) {
  if (level == 0) return;
  grey = grey_pyramid(full.image, level + 1);
  picture = {view_of(grey.back()), {}, full.camera.at_level(level)};
  if (full.mask.empty()) return;
  hidden = small_mask(full.mask, level);
  picture.mask = {hidden.data(), picture.camera.width, picture.camera.height, 0, PixelFormat::r8};
}

std::optional<double> median_depth(const View& view) {
  std::vector<float> depth;
  std::copy_if(view.depth.begin(), view.depth.end(), std::back_inserter(depth), [](float z) { return z > 0; });
  if (depth.empty()) return std::nullopt;
  const auto middle = depth.begin() + static_cast<ptrdiff_t>(depth.size() / 2);
  std::nth_element(depth.begin(), middle, depth.end());
  return *middle;
}

double motion(const Camera& camera, const SE3& T, double distance) {
  double most = 0;
  for (const double u : {0.0, camera.width - 1.0})
    for (const double v : {0.0, camera.height - 1.0}) {
      const Eigen::Vector3d X = T * Eigen::Vector3d(distance * camera.ray({u, v}));
      if (X.z() <= 0) return INFINITY;
      most = std::max(most, (camera.project(X) - Eigen::Vector2d(u, v)).norm());
    }
  return most;
}

}  // namespace iclk::internal
