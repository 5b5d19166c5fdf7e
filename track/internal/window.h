#pragma once
#include <span>
#include <vector>

#include <iclk/track/internal/bundle.h>
#include <iclk/track/internal/judge.h>

namespace iclk::internal {

/// A keyframe near a new one, and how they were aligned: `there` is the new one's frame with that one, `back` the other way.
struct Neighbour {
  Keyframe* keyframe = nullptr;
  RefinedAlignment there = {}, back = {};
};

/// The newest keyframes, connected with each other and adjusted together.
class Window {
 public:
  /// `size`: TrackerOptions::window.
  Window(const Camera& camera, const Judge& judge, Refiner& refiner, Keyframes& keyframes, int size)
      : camera_(camera), judge_(judge), refiner_(refiner), keyframes_(keyframes), size_(size) {}

  /// Of a frame that is to become a keyframe. `found`: its alignment with one of them, if there is one. None is the keyframe
  /// that leaves for it.
  std::vector<Neighbour> neighbours_of(const TrackFrame& frame, const SE3& T_WC, const Found* found);
  /// Aligns the neighbours with the new keyframe, and keeps what each sees of the other.
  void connect(Keyframe& k, std::span<Neighbour> neighbours);
  /// Poses and inverse depths of the newest.
  void adjust();

 private:
  /// Keyframes of a bundle, and where they are in it.
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
