#pragma once
#include <span>
#include <vector>

#include <iclk/track/internal/edge_cost.h>
#include <iclk/track/internal/window.h>

namespace iclk::internal {

/// The graph of the motions between keyframes. Closes loops: when the camera comes back to a place, the drift since then is
/// distributed over the keyframes of the way.
class Loops {
 public:
  Loops(const Camera& camera, const Judge& judge, Keyframes& keyframes)
      : camera_(camera), judge_(judge), keyframes_(keyframes) {}

  /// Adds the motions to a new keyframe from those with which it was aligned.
  void follow(const Keyframe& k, std::span<const Neighbour> neighbours);
  /// Whether drift can explain what a motion between keyframes of one map would correct. If not, another place looks alike.
  bool plausible(const BundleEdge& edge) const;
  /// Adds a plausible motion between keyframes that were found to see the same place. The first one only waits for another
  /// that asks for the same correction. Returns whether the poses of keyframes changed.
  bool close(const BundleEdge& edge);
  /// Adds a motion between keyframes by which two maps were joined.
  void join(const BundleEdge& edge) { state.loops.push_back(edge); }

  struct State {
    std::vector<BundleEdge> motions, loops;
    std::vector<BundleEdge> waiting;  ///< at most one
  } state;

 private:
  SE3 correction(const BundleEdge& edge) const;
  bool adjust(int map, int oldest);
  std::vector<BundleEdge> edges_of(const std::vector<int>& index) const;

  Camera camera_;
  const Judge& judge_;
  Keyframes& keyframes_;
};

}  // namespace iclk::internal
