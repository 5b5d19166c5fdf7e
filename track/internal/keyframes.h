#pragma once
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>
#include <iclk/track/internal/depth_filter.h>
#include <iclk/track/internal/frame.h>
#include <iclk/track/internal/signature.h>

namespace iclk::internal {

/// A frame with which others are aligned.
struct Keyframe {
  int id = 0;
  int slot = 0;  ///< of the aligner
  int map = 0;   ///< poses of different maps are unrelated
  double time = 0;
  int64_t used = 0;  ///< Keyframes::clock when a frame was last aligned with it
  double way = 0;    ///< length of the camera's way up to it
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
  Signature signature;
  std::optional<TrackResult::Origin> origin;
  /// The positions of this keyframe's features in the images of other keyframes, by id.
  std::map<int, std::vector<AlignedFeature>> sightings;
};

double mean_inverse_depth(const Keyframe& keyframe);

/// The pair that aligns a frame with a keyframe, starting at camera pose T_WC.
Pair pair_of(const Keyframe& keyframe, const TrackFrame& frame, const SE3& T_WC, bool search = false);

/// Whether uv is in the image, at least `border` px from its border.
bool inside(const Camera& camera, const Eigen::Vector2d& uv, double border);

/// The covariance of a keyframe's motion from `from`.
Matrix6d edge_covariance(const TrackResult::Origin& origin, const Keyframe& from);

/// px: the largest distance by which `off`, a motion of the camera, moves the image corners at depth z. Infinite if one leaves.
double corner_motion(const Camera& camera, const SE3& off, double z);

/// The view of a keyframe's features by camera T_WC.
struct Overlap {
  double visible = 0;  ///< share of the features that lie in the image, a patch away from the border
  double flow = 0;     ///< px, mean motion of those features
};
Overlap overlap(const Camera& camera, const Keyframe& keyframe, const SE3& T_WC);

/// Where a keyframe is.
struct Place {
  SE3 T_WC;
  int map = 0;
};

/// The keyframes, and the places of all that were ever made. At most `capacity` are held, each in a slot of the aligner. Others
/// are archived, at most `archive`; beyond that, those that were not used for longest are forgotten.
class Keyframes {
 public:
  /// The number of archived keyframes that can be opened together, in slots behind those of the held ones.
  static constexpr int kOpen = 8;

  Keyframes(Aligner& aligner, const Camera& camera, int capacity, int archive)
      : aligner_(aligner), camera_(camera), capacity_(capacity), archive_(static_cast<size_t>(archive)) {}

  int64_t clock = 0;  ///< frames that have come, of all recordings

  /// Adds a keyframe of the current map, in a free slot or instead of leaving().
  Keyframe& add(double time, const SE3& T_WC);
  /// Sets the reference of the aligner, with the present inverse depths.
  void prepare(const Keyframe& keyframe);
  /// The held keyframe that the next one replaces: the one that was not used for longest, or -1 if a slot is free.
  int leaving() const;
  /// Finds a keyframe of those held, or opens an archived one for alignments: it gets a slot until others are opened.
  Keyframe& open(int id);
  /// Holds an archived keyframe again, instead of leaving().
  Keyframe& hold(int id);
  /// Holds the archived keyframes before and after those that `k` sees again, since they will be seen next.
  void hold_next(const Keyframe& k, int window);
  const std::map<int, Keyframe>& archived() const { return archived_; }
  /// Calls f(keyframe) for all keyframes, held or archived.
  template <class F>
  void each(const F& f) const {
    for (const auto* some : {&held_, &archived_})
      for (const auto& [id, k] : *some) f(k);
  }
  /// Restores another instance.
  void restore(std::map<int, Keyframe> held, std::map<int, Keyframe> archived, std::vector<Place> places, int map);
  bool empty() const { return held_.empty(); }
  int size() const { return static_cast<int>(held_.size()); }
  Keyframe* find(int id);
  Keyframe& newest() { return held_.rbegin()->second; }
  Keyframe& newest_of_map();                        ///< the current one
  std::map<int, Keyframe>& all() { return held_; }  ///< by id, oldest first
  const std::map<int, Keyframe>& all() const { return held_; }
  void set_pose(int id, const SE3& T_WC);
  const std::vector<Place>& places() const { return places_; }

  /// The map in which the camera is.
  int current_map() const { return map_; }
  void enter(int map) { map_ = map; }
  /// Moves all keyframes of one map to another one.
  void join(int from, int into, const SE3& T_into_from);

  /// At most `count` keyframes of the current map with the largest Overlap::visible by camera T_WC, best first, each at least
  /// `least`.
  std::vector<int> best(const SE3& T_WC, size_t count, double least) const;

 private:
  Aligner& aligner_;
  Camera camera_;
  int capacity_;
  size_t archive_;
  int free_slot();
  void archive(Keyframe&& k);

  std::map<int, Keyframe> held_, archived_;
  std::vector<Place> places_;
  int map_ = 0;
  int opened_ = 0;  // slots that were given to archived keyframes, in turn
};

}  // namespace iclk::internal
