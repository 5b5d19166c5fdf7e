#include <iclk/locate/internal/map_window.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>

#include <iclk/render/internal/windows.h>

namespace iclk::internal {
namespace {

constexpr double kNear = 100;         // m around the camera where its ground is looked for first
constexpr double kSearchedFor = 2e4;  // m, at most
constexpr double kFar = 10;           // heights above the ground: what lies farther away is not read
constexpr double kTexel = 0.5;        // of a picture's pixel on the ground
constexpr double kMargin = 0.25;      // of the width, read for the pictures that follow

MapBox grown(const MapBox& box, double x, double y) { return {box.left - x, box.bottom - y, box.right + x, box.top + y}; }

bool inside(const MapBox& a, const MapBox& b) {
  constexpr double edge = 1e-6;
  return a.empty() || (b.contains(a.left + edge, a.bottom + edge) && b.contains(a.right - edge, a.top - edge));
}

MapBox together(const MapBox& a, const MapBox& b) {
  if (a.empty() || b.empty()) return a.empty() ? b : a;
  return {std::min(a.left, b.left), std::min(a.bottom, b.bottom), std::max(a.right, b.right), std::max(a.top, b.top)};
}

}  // namespace

MapWindow::MapWindow(std::shared_ptr<engine::Context> context, std::shared_ptr<const TerrainSource> source,
                     const RenderOptions& options)
    : context_(std::move(context)), source_(std::move(source)), options_(options) {}

bool MapWindow::read(const MapBox& box, double texel) {
  std::shared_ptr<const Terrain> terrain = source_->window(box, texel);
  if (!terrain) return false;
  box_ = box, texel_ = texel;
  if (terrain == terrain_) return true;
  terrain_ = std::move(terrain);
  std::vector<float> heights;
  std::copy_if(terrain_->height.begin(), terrain_->height.end(), std::back_inserter(heights),
               [](float h) { return std::isfinite(h); });
  const auto middle = heights.begin() + static_cast<ptrdiff_t>(heights.size() / 2);
  std::nth_element(heights.begin(), middle, heights.end());
  median_ = *middle;
  const auto [low, high] = std::minmax_element(heights.begin(), heights.end());
  lowest_ = *low, highest_ = *high;
  return true;
}

/// Some ground near the camera, as near as there is.
bool MapWindow::find_ground(const Eigen::Vector3d& at, double spread) {
  if (terrain_ && terrain_->height_at(at.x(), at.y())) return true;
  for (double r = spread + kNear; r < spread + kSearchedFor; r *= 3)
    if (read({at.x() - r, at.y() - r, at.x() + r, at.y() + r}, r / 100)) return true;
  return false;
}

/// The part of the map in front of the camera. An unknown heading makes it a circle.
MapBox MapWindow::seen(const Camera& camera, const LocatePrior& prior, double reach) const {
  const double spread = reach * prior.position_sigma, up = reach * prior.height_sigma;
  const double tilt = std::tan(std::min(reach * prior.tilt_sigma, 1.0));
  const double far = kFar * std::max(prior.T_WC.t.z() + up - lowest_, 1.0);
  const Eigen::Vector3d& t = prior.T_WC.t;
  const MapBox limit = MapBox{t.x() - far, t.y() - far, t.x() + far, t.y() + far};
  const PixelBox pixels{-0.5 - std::abs(camera.fx) * tilt, -0.5 - std::abs(camera.fy) * tilt,
                        camera.width - 0.5 + std::abs(camera.fx) * tilt, camera.height - 0.5 + std::abs(camera.fy) * tilt};
  const double range = std::min(reach * prior.heading_sigma, M_PI);
  const int turns = static_cast<int>(std::ceil(range / (M_PI / 18)));
  MapBox box;
  for (int i = -turns; i <= turns; ++i) {
    const double heading = turns > 0 ? range * i / turns : 0;
    SE3 pose{Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()).toRotationMatrix() * prior.T_WC.R, t};
    pose.t.z() += up;
    box = together(box, footprint(camera, pose, pixels, lowest_, std::min(highest_, pose.t.z()), limit));
  }
  return grown(box, spread, spread).intersection(source_->extent());
}

bool MapWindow::serves(const MapBox& box, double texel) const {
  const bool fine = texel_ <= 1.5 * texel || terrain_->mosaic.step_x <= 1.5 * texel;
  const bool shrunk = terrain_->mosaic.step_x > 2.5 * texel_ && box.width() * box.height() < 0.2 * box_.width() * box_.height();
  return inside(box, box_) && fine && !shrunk;
}

bool MapWindow::cover(const Camera& camera, const LocatePrior& prior, double reach) {
  if (!find_ground(prior.T_WC.t, reach * prior.position_sigma)) return false;
  // What is seen depends on heights that are known once it is read.
  for (int i = 0; i < 3; ++i) {
    const MapBox box = seen(camera, prior, reach);
    if (box.empty()) break;
    const double texel =
        kTexel * std::max(prior.T_WC.t.z() - median_, 1.0) / std::max(std::abs(camera.fx), std::abs(camera.fy));
    if (serves(box, texel)) break;
    if (!read(grown(box, kMargin * box.width(), kMargin * box.height()), texel)) break;
  }
  if (shown_ != terrain_) {
    if (renderer_)
      renderer_->show(terrain_);
    else
      renderer_.emplace(context_, terrain_, options_);
    shown_ = terrain_;
  }
  return true;
}

}  // namespace iclk::internal
