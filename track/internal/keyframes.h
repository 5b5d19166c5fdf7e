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

/// A frame that others are aligned with.
struct Keyframe {
  int id = 0;
  int slot = 0;  ///< of the aligner
  double time = 0;
  double sharpness = 0;
  SE3 T_WC;
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();       ///< rad, while its rows were read, beyond what they were unrolled with
  double turn_sigma = 0;                                ///< of it, an axis
  Eigen::Vector3d seen_turn = Eigen::Vector3d::Zero();  ///< the same by images alone, which knows nothing of the readout
  Features features;                                    ///< inverse depths as they are known now
  std::vector<double> measured, sigma;  ///< inverse depths as the sensor had them, and their standard deviations; 0: not known
  bool with_depth = false;              ///< a sensor measured most of its features
  /// A place that becomes a feature when its depth is known.
  struct Seed {
    Eigen::Vector2d uv = Eigen::Vector2d::Zero();
    DepthFilter filter;
  };
  std::vector<Seed> seeds;
  FramePixels pixels;  ///< later keyframes' features are looked for in them
  std::optional<TrackResult::Origin> origin;
  /// Keyframes in whose images this one's features were found, and where.
  std::map<int, std::vector<AlignedFeature>> sightings;
};

double mean_inverse_depth(const Keyframe& keyframe);

/// To align a frame with a keyframe, from where camera T_WC would be.
Pair pair_of(const Keyframe& keyframe, const TrackFrame& frame, const SE3& T_WC, bool search = false);

/// In the image, so many px from its border.
bool inside(const Camera& camera, const Eigen::Vector2d& uv, double border);

/// What camera T_WC would see of a keyframe.
struct Overlap {
  double visible = 0;  ///< share of its features that lie in the image, a patch away from the border
  double flow = 0;     ///< px, mean motion of those features
};
Overlap overlap(const Camera& camera, const Keyframe& keyframe, const SE3& T_WC);

/// At most `capacity` keyframes, each in a slot of the aligner. Poses of all that ever were are kept.
class Keyframes {
 public:
  Keyframes(Aligner& aligner, const Camera& camera, int capacity) : aligner_(aligner), camera_(camera), capacity_(capacity) {}

  /// A new one, in a free slot or in that of the one which leaves.
  Keyframe& add(double time, const SE3& T_WC);
  /// Has the aligner know of its features what is known now.
  void prepare(const Keyframe& keyframe);
  /// The one which leaves for the next: the oldest, or -1.
  int leaving() const { return size() == capacity_ ? held_.begin()->first : -1; }
  /// Those that another one held.
  void restore(std::map<int, Keyframe> held, std::vector<SE3> poses);
  /// Holds none any more; the poses stay.
  void forget() { held_.clear(); }
  bool empty() const { return held_.empty(); }
  int size() const { return static_cast<int>(held_.size()); }
  Keyframe* find(int id);
  Keyframe& newest() { return held_.rbegin()->second; }
  std::map<int, Keyframe>& all() { return held_; }  ///< by id, oldest first
  const std::map<int, Keyframe>& all() const { return held_; }
  void set_pose(int id, const SE3& T_WC);
  const std::vector<SE3>& poses() const { return poses_; }

  /// Those that show most of what camera T_WC sees, best first, with a share of at least `least`.
  std::vector<int> best(const SE3& T_WC, size_t count, double least) const;

 private:
  Aligner& aligner_;
  Camera camera_;
  int capacity_;
  std::map<int, Keyframe> held_;
  std::vector<SE3> poses_;
};

}  // namespace iclk::internal
