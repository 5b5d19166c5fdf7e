#pragma once
#include <memory>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/locate/internal/map_window.h>
#include <iclk/locate/internal/picture.h>
#include <iclk/locate/locator.h>
#include <iclk/session/session.h>

namespace iclk::internal {

/// Positions and heights of a map are off by a share of its pixels, which images of one camera are not. On a map, nothing
/// moves.
SessionOptions fit_options(SessionOptions options);

/// Aligns pictures with views of the map at the poses that are found, until the pose stays.
class MapFit {
 public:
  struct Fit {
    Located located;
    /// Why a converged pose is a rival of others, but no claim: picture and map may be lit differently. Else empty.
    std::string doubt;
  };

  MapFit(std::shared_ptr<engine::Context> context, MapWindow& map, const LocatorOptions& options);

  /// Fits the picture, which is as coarse as the map, from this pose. `finest`: m, the size on the ground of what picture and
  /// map both show. Poses that may place the ground worse than that by other light are doubted.
  Fit fit(const Picture& picture, const SE3& start, double finest);

  bool above_ground(const SE3& T_WC) const;
  const std::shared_ptr<engine::Context>& context() const { return session_.context(); }

 private:
  /// One view: its pose, the alignment, and the ground that it rests on.
  struct Round {
    SE3 T_WV;
    double distance = 0;  ///< m
    RefinedAlignment answer;
    std::vector<Eigen::Vector3d> points;  ///< in the camera's frame
  };
  /// False if the map shows nothing there; `located` then says so.
  bool look(const Picture& picture, Located& located, Round& round);
  /// The covariance of a converged pose. False if it has none.
  bool judge(const Picture& picture, const Round& round, double finest, Fit& fit) const;
  std::vector<double> roughness(const Round& round, const SE3& T_WC) const;

  MapWindow& map_;
  LocatorOptions options_;
  Session session_;
};

}  // namespace iclk::internal
