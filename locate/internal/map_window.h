#pragma once
#include <memory>
#include <optional>

#include <iclk/locate/locator.h>
#include <iclk/render/renderer.h>
#include <iclk/render/terrain_source.h>

namespace iclk::internal {

/// The part of a map that a picture is compared with, on the device. It is read again only if a picture needs another part.
class MapWindow {
 public:
  MapWindow(std::shared_ptr<engine::Context> context, std::shared_ptr<const TerrainSource> source,
            const RenderOptions& options);

  /// Makes sure that everything is there that the camera sees from `reach` sigmas around the prior, up to ten times its height
  /// away. False: nothing of the map lies there. Throws the errors of TerrainSource::window() and TerrainRenderer.
  bool cover(const Camera& camera, const LocatePrior& prior, double reach);
  /// After cover() only.
  TerrainRenderer& renderer() { return *renderer_; }
  const Terrain& terrain() const { return *terrain_; }

 private:
  bool find_ground(const Eigen::Vector3d& at, double spread);
  bool read(const MapBox& box, double texel);
  MapBox seen(const Camera& camera, const LocatePrior& prior, double reach) const;
  bool serves(const MapBox& box, double texel) const;

  std::shared_ptr<engine::Context> context_;
  std::shared_ptr<const TerrainSource> source_;
  RenderOptions options_;
  std::shared_ptr<const Terrain> terrain_, shown_;
  std::optional<TerrainRenderer> renderer_;
  MapBox box_;        // that was read
  double texel_ = 0;  // m, that was asked for
  double lowest_ = 0, median_ = 0, highest_ = 0;
};

}  // namespace iclk::internal
