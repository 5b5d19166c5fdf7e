#pragma once
#include <cstdint>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/align/pyramid.h>
#include <iclk/refine/refiner.h>
#include <iclk/track/depth_filter.h>

namespace iclk {

struct TrackFrame;

/// A copy of a frame's images, rows packed.
struct FramePixels {
  double time = 0;
  std::vector<uint8_t> image, mask;
  std::vector<float> depth;
  PixelFormat format = PixelFormat::r8;

  void keep(const TrackFrame& frame);
  /// Of this copy, which must outlive it.
  TrackFrame frame(const Camera& camera) const;
};

/// Energy of a grey image's gradients, at half its size: what blur takes away.
double sharpness(const Map& grey);

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
  /// How it was found: by the alignment with another one.
  struct Origin {
    int keyframe = 0;
    SE3 T_CK;  ///< of that one's camera to this one's
    bool confirmed = true;
    Matrix6d covariance = Matrix6d::Identity();
  };
  std::optional<Origin> origin;
  /// Keyframes in whose images this one's features were found, and where.
  std::map<int, std::vector<AlignedFeature>> sightings;
};

double mean_inverse_depth(const Keyframe& keyframe);

/// What camera T_WC would see of a keyframe.
struct Overlap {
  double visible = 0;  ///< share of its features that lie in the image, a patch away from the border
  double flow = 0;     ///< px, mean motion of those features
};
Overlap overlap(const Camera& camera, const Keyframe& keyframe, const SE3& T_WC);

/// At most `capacity` keyframes, each in a slot of its own. Poses of all that ever were are kept.
class Keyframes {
 public:
  explicit Keyframes(int capacity) : capacity_(capacity) {}

  /// A new one, in a free slot or in that of the one which leaves: the oldest.
  Keyframe& add(double time, const SE3& T_WC);
  /// Those that another one held.
  void restore(std::map<int, Keyframe> held, std::vector<SE3> poses) {
    held_ = std::move(held);
    poses_ = std::move(poses);
  }
  /// Holds none any more; the poses stay.
  void forget() { held_.clear(); }
  bool empty() const { return held_.empty(); }
  int size() const { return static_cast<int>(held_.size()); }
  int count() const { return static_cast<int>(poses_.size()); }  ///< that ever were
  Keyframe* find(int id);
  Keyframe& newest() { return held_.rbegin()->second; }
  std::map<int, Keyframe>& all() { return held_; }  ///< by id, oldest first
  const std::map<int, Keyframe>& all() const { return held_; }
  void set_pose(int id, const SE3& T_WC);
  const SE3& pose(int id) const { return poses_.at(static_cast<size_t>(id)); }

  /// Those that show most of what camera T_WC sees, best first, with a share of at least `least`.
  std::vector<int> best(const Camera& camera, const SE3& T_WC, size_t count, double least) const;

 private:
  int capacity_;
  std::map<int, Keyframe> held_;
  std::vector<SE3> poses_;
};

}  // namespace iclk
