#pragma once
#include <optional>
#include <span>
#include <vector>

#include <iclk/track/internal/judge.h>

namespace iclk::internal {

/// Two keyframes that see the same place.
struct Link {
  int from = 0, to = 0;
  SE3 T_to_from;  ///< camera of keyframe `from` to camera of keyframe `to`
  Matrix6d covariance = Matrix6d::Zero();
};

/// Finds keyframes that see the same place as a new one, although nothing says where they are. A wrong link is worse than none.
/// It needs three alignments that agree: of the new keyframe and of the frame before with the other one, and back.
class PlaceFinder {
 public:
  /// `batch`: the largest number of pairs that are aligned at once.
  PlaceFinder(const Camera& camera, const Judge& judge, Refiner& refiner, Keyframes& keyframes, int batch)
      : camera_(camera), judge_(judge), refiner_(refiner), keyframes_(keyframes), batch_(static_cast<size_t>(batch)) {}

  /// A link from a keyframe of another map to `k`. `before`: the frame before `k`, at T_WC in the same map. Tries one batch of
  /// keyframes per call, in turn. Stores the sightings of each keyframe in the other.
  std::optional<Link> find_in_other_maps(Keyframe& k, const TrackFrame& before, const SE3& T_WC);

  struct State {
    int next_tried = 0;
  } state;

 private:
  std::vector<int> in_other_maps(const Keyframe& k);
  std::optional<Link> verify(Keyframe& k, Keyframe& other, RefinedAlignment there, const TrackFrame& before,
                             const SE3& T_before_k);

  Camera camera_;
  const Judge& judge_;
  Refiner& refiner_;
  Keyframes& keyframes_;
  size_t batch_;
};

}  // namespace iclk::internal
