#pragma once
#include <memory>
#include <optional>
#include <vector>

#include <iclk/locate/locator.h>

namespace iclk {

/// A frame of a sequence. Pointers are read during the call only.
struct LocatorFrame {
  double time = 0;  ///< s; later than the previous frame
  ImageView image;  ///< undistorted, of the camera's size
  ImageView mask;   ///< r8; pixels that are 0 are not used. May be empty; needs SequenceLocatorOptions::masks
  /// Where the frame may be, for frames whose predecessors are not known. Without one, the last known prior is used.
  std::optional<LocatePrior> prior;
};

/// Where a frame of a sequence was taken.
struct SequencePose {
  double time = 0;
  Located located;                         ///< on the map, without the other frames
  bool known = false;                      ///< whether T_WC is: from the map, or by the motion from frames that were located
  SE3 T_WC;                                ///< camera to map, by all that is known
  Matrix6d covariance = Matrix6d::Zero();  ///< of xi = [rho, phi] in T_WC = mean Exp(xi), in the camera's frame
};

struct SequenceLocatorOptions {
  bool masks = false;        ///< frames may have masks
  int anchors = 10;          ///< located frames back to which live poses are adjusted
  double drift = 0.002;      ///< of the way: standard deviation that is added to each motion, for what its frames share
  double contradiction = 8;  ///< standard deviations between a pose on the map and the motion; above, the pose is dropped

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Locates the frames of a sequence on a map. A Tracker estimates the motion between frames, with depth from the map where a
/// frame was located and by motion elsewhere. Poses on the map and motions are adjusted together (Ceres). Frames that the map
/// does not show keep a pose, whose covariance grows with the way from the last one that was located; it shrinks as soon as the
/// next one is. One thread at a time.
class SequenceLocator {
 public:
  /// `locator` must outlive it. Throws the errors of Session and Tracker, and Error(invalid_argument) for bad options.
  SequenceLocator(Locator& locator, const Camera& camera, const SequenceLocatorOptions& options = {});
  ~SequenceLocator();

  /// The next frame, with its live pose. Throws Error(invalid_argument) for a time that is not later, for a first frame without
  /// a prior, and the errors of Locator::locate() and Tracker::track().
  SequencePose locate(const LocatorFrame& frame);
  /// The poses of all frames so far, from all anchors and motions: what came later also counts.
  std::vector<SequencePose> all();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
