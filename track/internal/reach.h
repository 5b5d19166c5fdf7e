#pragma once
#include <vector>

#include <iclk/track/internal/keyframes.h>

namespace iclk::internal {

struct BundleEdge;

/// How far the camera can have come while it had no pose. A place that looks alike but lies farther away is not the same place.
class Reach {
 public:
  explicit Reach(const Keyframes& keyframes) : keyframes_(keyframes) {}

  /// The camera moved by `distance` in `seconds`.
  void move(double distance, double seconds);
  /// The camera was lost. Its last pose: `distance` from a keyframe, after `way`.
  void leave(int keyframe, double distance, double time, double way);
  /// The camera is found, `distance` from a keyframe.
  void arrive(const Keyframe& k, double distance, double time);
  /// Forgets when the camera was lost: it can be anywhere.
  void move_freely();

  /// Whether a lost camera can be at T_WC, found with keyframe `k`.
  bool allows(const Keyframe& k, const SE3& T_WC, double time) const;
  /// Whether a link can join the maps of `from` and `to`. A link that cannot proves that places repeat. From then on, looks do
  /// not tell where the camera is in a map that it did not leave or enter just before.
  bool allows(const Keyframe& from, const Keyframe& to, const BundleEdge& link);

  /// A time without a pose, between two poses.
  struct Break {
    int from = 0, to = -1;        ///< keyframes; -1: the camera is still lost
    double left = 0, way = 0;     ///< time and way at the first pose
    double away = 0, beyond = 0;  ///< distances of the poses to the keyframes
    double most = 0;              ///< between the poses
  };
  struct State {
    double speed = 0;           ///< the largest of late
    bool repeats = false;       ///< places that look alike are not the same
    std::vector<Break> breaks;  ///< between maps that are not joined, and the present one
  } state;

 private:
  bool lost() const { return !state.breaks.empty() && state.breaks.back().to < 0; }
  bool joins(const Break& b, int map, int other) const;
  int map_of(int keyframe) const;
  double most(const Keyframe& k, double seconds) const;
  double drift(const Keyframe& k, const Break& b) const;

  const Keyframes& keyframes_;
};

}  // namespace iclk::internal
