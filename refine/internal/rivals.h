#pragma once
#include <span>
#include <string>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// The input of one pair.
struct View {
  const Camera& camera;
  const Features& features;
  const std::vector<FeatureCheck>& checks;
};

/// The distance in image 1 between the projections of each feature by pose a and by pose b, px, sorted. It is infinite if one
/// pose puts the feature behind the camera.
std::vector<double> motions(const View& view, const SE3& a, const SE3& b);

/// The median of motions(); infinite if there are none.
double median_motion(const View& view, const SE3& a, const SE3& b);

/// Whether each feature is an inlier of a pose.
std::vector<bool> inliers(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                          const SE3& T_10, double inlier_distance);

/// Evidence in the target against an answer.
struct Elsewhere {
  /// Poses from other places that look like the features: one tile further, the background behind moving objects, the scene
  /// behind a caption. Poses with the most features come first.
  std::vector<SE3> poses;
  int seen = 0;  ///< features that do not agree with the answer and are clearly visible at another place
};
/// Searches for such evidence. `reference`: the grey map of level 0; an empty map gives no evidence. `agree`: inliers() of the
/// answer; `explained`: their share of the features with texture. The answer warps the patches. Returns at most `most` poses,
/// and none if the answer explains nearly all features and few look like other places.
Elsewhere look_elsewhere(const Map& reference, const Pair& pair, const Camera& camera, const Features& features,
                         std::span<const FeatureCheck> checks, const SE3& T_10, const std::vector<bool>& agree,
                         double explained, int most);

/// A comparison of two poses of one pair. Counted are the inliers of one pose that the other pose also projects into the image,
/// but explains worse.
struct Contest {
  int first = 0, second = 0;
  double first_reach = 0, second_reach = 0;  ///< px: the distance between these features
};
Contest compare(const Camera& camera, const Features& features, const RefinedAlignment& first, const RefinedAlignment& second,
                double inlier_distance);

/// Whether each feature stands still: an inlier within a tenth of a pixel of its position in the reference. For a pose without
/// refinement: a feature that the pose moves by at most `inlier_distance`.
std::vector<bool> still(const Camera& camera, const Features& features, const RefinedAlignment& answer, double inlier_distance);

/// Replaces the answer by the pose that dominates all others. If there is none, the answer becomes ambiguous.
void weigh(const View& view, const RefinerOptions& options, std::span<RefinedAlignment> rivals, RefinedAlignment& answer);

/// Replaces an unconfirmed pose of a model by a rival that the features confirm.
void prefer_confirmed(std::span<RefinedAlignment> rivals, RefinedAlignment& answer);

/// Doubts an answer of features that stand still while others are `seen` elsewhere. They may be fixed to the camera: a caption,
/// the own vehicle, dirt.
void doubt_stillness(const View& view, const RefinerOptions& options, int seen, RefinedAlignment& answer);

/// The texts that weigh() and doubt_stillness() put before the reason of an answer.
std::string rival_text(int inliers);
std::string stillness_text(int standing, int inliers, int seen);

}  // namespace iclk::internal
