#pragma once
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>
#include <iclk/track/keyframes.h>
#include <iclk/track/tracker.h>

namespace iclk {

/// When row v of an image was seen, as a share of the readout: -0.5 at the first row, 0.5 at the last, 0 at the frame's time.
inline double row_time(const Camera& camera, double v) { return (v + 0.5) / camera.height - 0.5; }

/// The frame as a camera sees it that reads all its rows at once, at the frame's time. `turn`: rotation vector of the camera's
/// motion while its rows were read, rad, in its own axes; taken as even. What the camera shifts meanwhile stays in: it would
/// need the depth of every pixel. Image: bilinear. Depth, as rolling as the image, and mask: nearest. Where the source has
/// nothing the mask is 0; without one in `frame`, so it is made.
void unroll(const TrackFrame& frame, const Camera& camera, const Eigen::Vector3d& turn, FramePixels& out);

/// A feature of a keyframe, and where it was found in a frame.
struct RollingSighting {
  Eigen::Vector2d uv0, uv1;
  double inverse_depth = 0;
};

/// How far a camera turned while its rows were read, by how that bends the image, as no pose does.
struct TurnEstimate {
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();  ///< rad, in the camera's axes, beyond what the image was unrolled with
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};
/// Pose and turn together, by robust least squares about T_10. `turn_0`: the keyframe's own, rad. `sigma`: px, of the
/// positions; `prior_sigma`: rad, of the turn about zero, an axis. Nothing where the sightings are too few.
std::optional<TurnEstimate> estimate_turn(const Camera& camera, const SE3& T_10, const Eigen::Vector3d& turn_0,
                                          std::span<const RollingSighting> sightings, double sigma, double prior_sigma);

/// How long the readout takes: turns while rows are read, over how fast the camera turned from frame to frame. Frames vote, so
/// that bad ones do not matter; memory does not grow.
class ReadoutEstimate {
 public:
  ReadoutEstimate();
  /// `turn`: rad, in all, of standard deviation `sigma` an axis; `rate`: rad/s, of the same camera at that time.
  void add(const Eigen::Vector3d& turn, double sigma, const Eigen::Vector3d& rate);
  double seconds() const;  ///< weighted median of the frames
  /// Calls f(value...) with all that it knows, to be kept or set.
  template <class F>
  void archive(const F& f) {
    f(votes_, weight_, weight2_);
  }
  double sigma() const;  ///< s, from how the frames scatter; infinite for too few

 private:
  double quantile(double share) const;

  std::vector<double> votes_;  ///< weights by turn over rate
  double weight_ = 0, weight2_ = 0;
};

}  // namespace iclk
