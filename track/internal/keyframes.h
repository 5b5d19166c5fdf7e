#pragma once
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>
#include <iclk/track/internal/depth_filter.h>
#include <iclk/track/internal/frame.h>

namespace iclk::internal {

/// A frame with which others are aligned.
struct Keyframe {
  int id = 0;
  int slot = 0;  ///< of the aligner
  double time = 0;
  double sharpness = 0;
  SE3 T_WC;
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();       ///< rad, while its rows were read, beyond the turn that was corrected
  double turn_sigma = 0;                                ///< of the turn, per axis
  Eigen::Vector3d seen_turn = Eigen::Vector3d::Zero();  ///< the turn from images alone, independent of the readout
  Features features;                                    ///< inverse depths by present knowledge
  std::vector<double> measured, sigma;                  ///< inverse depths of the sensor and their sigmas; 0: unknown
  bool with_depth = false;                              ///< a sensor measured most of its features
  /// A point that becomes a feature when its depth is known.
  struct Seed {
    Eigen::Vector2d uv = Eigen::Vector2d::Zero();
    DepthFilter filter;
  };
  std::vector<Seed> seeds;
  FramePixels pixels;  ///< in which features of later keyframes are searched for
  std::optional<TrackResult::Origin> origin;
  /// The positions of this keyframe's features in the images of other keyframes, by id.
  std::map<int, std::vector<AlignedFeature>> sightings;
};

double mean_inverse_depth(const Keyframe& keyframe);

/// The pair that aligns a frame with a keyframe, starting at camera pose T_WC.
Pair pair_of(const Keyframe& keyframe, const TrackFrame& frame, const SE3& T_WC, bool search = false);

/// Whether uv is in the image, at least `border` px from its border.
bool inside(const Camera& camera, const Eigen::Vector2d& uv, double border);

/// The view of a keyframe's features by camera T_WC.
struct Overlap {
  double visible = 0;  ///< share of the features that lie in the image, a patch away from the border
  double flow = 0;     ///< px, mean motion of those features
};
Overlap overlap(const Camera& camera, const Keyframe& keyframe, const SE3& T_WC);

/// At most `capacity` keyframes, each in a slot of the aligner. The poses of all keyframes ever made are kept.
class Keyframes {
 public:
  Keyframes(Aligner& aligner, const Camera& camera, int capacity) : aligner_(aligner), camera_(camera), capacity_(capacity) {}

  /// Adds a keyframe, in a free slot or instead of leaving().
  Keyframe& add(double time, const SE3& T_WC);
  /// Sets the reference of the aligner, with the present inverse depths.
  void prepare(const Keyframe& keyframe);
  /// The keyframe that the next one replaces: the oldest, or -1 if a slot is free.
  int leaving() const { return size() == capacity_ ? held_.begin()->first : -1; }
  /// Restores the keyframes and poses of another instance.
  void restore(std::map<int, Keyframe> held, std::vector<SE3> poses);
  /// Removes all keyframes, but keeps their poses.
  void forget() { held_.clear(); }
  bool empty() const { return held_.empty(); }
  int size() const { return static_cast<int>(held_.size()); }
  Keyframe* find(int id);
  Keyframe& newest() { return held_.rbegin()->second; }
  std::map<int, Keyframe>& all() { return held_; }  ///< by id, oldest first
  const std::map<int, Keyframe>& all() const { return held_; }
  void set_pose(int id, const SE3& T_WC);
  const std::vector<SE3>& poses() const { return poses_; }

  /// At most `count` keyframes with the largest Overlap::visible by camera T_WC, best first, each at least `least`.
  std::vector<int> best(const SE3& T_WC, size_t count, double least) const;

 private:
  Aligner& aligner_;
  Camera camera_;
  int capacity_;
  std::map<int, Keyframe> held_;
  std::vector<SE3> poses_;
};

}  // namespace iclk::internal
