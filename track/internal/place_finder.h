#pragma once
#include <optional>
#include <span>
#include <vector>

#include <iclk/track/internal/edge_cost.h>
#include <iclk/track/internal/judge.h>

namespace iclk::internal {

/// A motion between keyframes that see the same place, and the positions of each one's features in the other.
struct Link {
  BundleEdge edge;
  std::vector<AlignedFeature> there, back;  ///< features of edge.from in edge.to, and the other way
};

/// Finds keyframes that see the same place as a new one, although it was not aligned with them: of other maps, or of the same
/// map from an earlier visit. A wrong link is worse than none. It needs three alignments that agree: of the new keyframe and of
/// the frame before with the other one, and back. There must be no other place where the keyframe fits as well.
class PlaceFinder {
 public:
  PlaceFinder(const Camera& camera, const Judge& judge, Refiner& refiner, Keyframes& keyframes, int window)
      : camera_(camera), judge_(judge), refiner_(refiner), keyframes_(keyframes), window_(window) {}

  /// A link from another keyframe to `k`. `before`: the frame before `k`, at T_WC in the same map.
  std::optional<Link> find(Keyframe& k, const TrackFrame& before, const SE3& T_WC);

 private:
  struct Candidate {
    int id = 0;
    bool by_matching = true;  ///< else from its pose in the map
  };
  std::vector<Candidate> candidates(const Keyframe& k) const;
  std::optional<Link> verify(const Keyframe& k, const Keyframe& other, RefinedAlignment there, const TrackFrame& before,
                             const SE3& T_before_k);

  Camera camera_;
  const Judge& judge_;
  Refiner& refiner_;
  Keyframes& keyframes_;
  int window_;
};

}  // namespace iclk::internal
