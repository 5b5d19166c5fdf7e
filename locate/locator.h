#pragma once
#include <memory>
#include <string>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/image.h>
#include <iclk/engine/context.h>
#include <iclk/render/renderer.h>
#include <iclk/render/terrain_source.h>
#include <iclk/session/options.h>

namespace iclk {

/// What is known about a picture's pose before it is located. Sigmas are standard deviations.
struct LocatePrior {
  SE3 T_WC;                    ///< camera (x right, y down, z forward) to map (x east, y north, z up), m
  double position_sigma = 10;  ///< m, of x and of y
  double height_sigma = 10;    ///< m, of z
  double tilt_sigma = 0.05;    ///< rad, of the optical axis about any horizontal axis
  double heading_sigma = 0.1;  ///< rad, about the vertical; pi: unknown

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

struct LocatorOptions {
  SessionOptions session;  ///< for the alignment of a picture with views of the map
  double reach = 2;        ///< the search covers this many sigmas of the prior
  int coarse_width = 192;  ///< px: width of the views that hypotheses are compared by, approximately
  int candidates = 4;      ///< hypotheses that are aligned at the map's resolution, at most
  int rounds = 6;          ///< views rendered for one candidate, at most
  double tolerance = 0.3;  ///< px: rounds end when the picture moves by less against the view, or within the covariance

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Where a picture was taken.
struct Located {
  Status status = Status::diverged;
  std::string reason;  ///< explains the status
  SE3 T_WC;            ///< camera to map; valid only if the status is converged
  /// Of xi = [rho, phi] in T_WC = mean Exp(xi), in the camera's frame; zero unless converged. It has the errors of the
  /// alignment and usual errors of a map: its pixels are off by a share of their size, its heights by a share of their spacing.
  /// A shift of the whole map is not in it.
  Matrix6d covariance = Matrix6d::Zero();
  std::vector<SE3> rivals;       ///< T_WC of other poses that fit as well; only with Status::ambiguous
  std::string model;             ///< the model that answered
  int hypotheses = 0;            ///< poses that were compared
  int rounds = 0;                ///< views rendered for this answer
  int inliers = 0, visible = 0;  ///< features that agree with the pose, of those that lie in the picture
  double sigma = 0;              ///< px at the map's resolution: robust standard deviation of the reprojection residuals

  bool converged() const { return status == Status::converged; }
};

/// Locates pictures on a map. It renders small views at poses that cover the prior, aligns the picture with each, and aligns it
/// again at the map's resolution with views at the best poses. A view is rendered again at the pose found, until it stays.
/// Pictures that fit at two places are ambiguous. One thread at a time.
class Locator {
 public:
  /// Throws the errors of TerrainRenderer, Session and LocatorOptions::check().
  Locator(std::shared_ptr<engine::Context> context, std::shared_ptr<const Terrain> map, const LocatorOptions& options = {});
  /// Reads the map window by window: what the prior can see. locate() and view() then also throw the source's errors.
  Locator(std::shared_ptr<engine::Context> context, std::shared_ptr<const TerrainSource> map,
          const LocatorOptions& options = {});
  ~Locator();

  /// `image`: undistorted, of the camera's size. `mask`: r8, of the same size; its pixels that are 0 are not used, such as the
  /// border of an undistorted image; empty: all are used. Throws Error(invalid_argument) for another size, a bad camera, a bad
  /// prior, and too many hypotheses; Error(device_lost). Pictures that cannot be located get a status; they never throw.
  Located locate(const ImageView& image, const Camera& camera, const LocatePrior& prior, const ImageView& mask = {});
  /// What the map looks like from a pose. Throws the errors of TerrainRenderer::render(), and Error(invalid_argument) if the
  /// map has nothing there.
  View view(const Camera& camera, const SE3& T_WC);

  const LocatorOptions& options() const;
  const std::shared_ptr<engine::Context>& context() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
