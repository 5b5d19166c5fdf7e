#pragma once
#include <span>
#include <string>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// What refinement knows of one pair.
struct View {
  const Camera& camera;
  const Features& features;
  const std::vector<FeatureCheck>& checks;
};

/// How far each feature moves in image 1 from pose a to pose b, px; infinite where one of them puts it behind the camera.
/// Sorted.
std::vector<double> motions(const View& view, const SE3& a, const SE3& b);

/// Inliers of a pose, one flag a feature.
std::vector<bool> inliers(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                          const SE3& T_10, double inlier_distance);

/// What the target shows elsewhere than an answer puts it.
struct Elsewhere {
  /// Poses on which features agree by places that look like them: one tile further, the background behind what moves, the
  /// scene behind a caption. Those with the most features first.
  std::vector<SE3> poses;
  int seen = 0;  ///< features that do not agree with the answer and are seen clearly at another place
};
/// `reference`: of level 0; an empty map shows nothing. `agree`: inliers() of the answer, `explained` their share of the
/// features with texture. Patches are compared as the answer warps them. At most `most` poses; none where nearly all is
/// explained and little looks like another place.
Elsewhere look_elsewhere(const Map& reference, const Pair& pair, const Camera& camera, const Features& features,
                         std::span<const FeatureCheck> checks, const SE3& T_10, const std::vector<bool>& agree,
                         double explained, int most);

/// What two poses of one pair have for themselves: inliers that the other pose shows too, and does not explain as well.
struct Contest {
  int first = 0, second = 0;
  double first_reach = 0, second_reach = 0;  ///< px: how far these lie apart
};
Contest compare(const Camera& camera, const Features& features, const RefinedAlignment& first, const RefinedAlignment& second,
                double inlier_distance);

/// Inliers that are where the reference has them, to a tenth of a pixel; of a pose that is not refined, features that it moves
/// by no more than `inlier_distance`.
std::vector<bool> still(const Camera& camera, const Features& features, const RefinedAlignment& answer, double inlier_distance);

/// The answer becomes the pose among these that dominates all others; where none does, it is ambiguous.
void weigh(const View& view, const RefinerOptions& options, std::span<RefinedAlignment> rivals, RefinedAlignment& answer);

/// A pose that the features confirm is better than a model's that they do not.
void prefer_confirmed(std::span<RefinedAlignment> rivals, RefinedAlignment& answer);

/// What stands still while other features are `seen` elsewhere may be fixed to the camera: a caption, the own vehicle, dirt.
void doubt_stillness(const View& view, const RefinerOptions& options, int seen, RefinedAlignment& answer);

/// What these two say before the reason of an answer that they doubt.
std::string rival_text(int inliers);
std::string stillness_text(int standing, int inliers, int seen);

}  // namespace iclk::internal
