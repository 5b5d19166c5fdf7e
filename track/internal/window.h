#pragma once
#include <span>
#include <vector>

#include <iclk/track/internal/bundle.h>
#include <iclk/track/internal/judge.h>

namespace iclk::internal {

/// A keyframe near a new one, and their alignments: `there` is the new frame with that keyframe, `back` the other way.
struct Neighbour {
  Keyframe* keyframe = nullptr;
  RefinedAlignment there = {}, back = {};
};

/// Connects the newest keyframes with each other and adjusts them together.
class Window {
 public:
  /// `size`: TrackerOptions::window.
  Window(const Camera& camera, const Judge& judge, Refiner& refiner, Keyframes& keyframes, int size)
      : camera_(camera), judge_(judge), refiner_(refiner), keyframes_(keyframes), size_(size) {}

  /// Finds the neighbours of a frame that becomes a keyframe. `found`: its alignment with one of them, or null. The keyframe
  /// that it replaces is left out.
  std::vector<Neighbour> neighbours_of(const TrackFrame& frame, const SE3& T_WC, const Found* found);
  /// Aligns the neighbours with the new keyframe, and stores the sightings of each in the other.
  void connect(Keyframe& k, std::span<Neighbour> neighbours);
  /// Adjusts poses and inverse depths of the newest keyframes.
  void adjust();

 private:
  /// Keyframes of a bundle, and their indices in it.
  struct Part {
    std::map<int, int> index;
    std::vector<BundleFrame> frames;
  };
  Part part();
  std::vector<BundleSighting> sightings_of(const Part& part);
  std::vector<BundleEdge> edges_of(const Part& part);

  Camera camera_;
  const Judge& judge_;
  Refiner& refiner_;
  Keyframes& keyframes_;
  int size_;
};

}  // namespace iclk::internal
