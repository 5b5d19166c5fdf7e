#pragma once
#include <array>
#include <optional>
#include <span>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/options.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

/// The sizes of the search by matching (AlignerOptions::search). Pure arithmetic.
struct MatchLayout {
  MatchLayout() = default;
  MatchLayout(const Plan& plan, const AlignerOptions& options);

  bool enabled = false;            ///< also false if the images are too small
  int scale = 1;                   ///< image pixels per pixel of the matched grey map
  int width = 0, height = 0;       ///< of that map
  int places_x = 0, places_y = 0;  ///< positions of a patch in it
  int tiles_x = 0, tiles_y = 0;    ///< of places
  int features = 0;                ///< matched features of a reference, at most
  int first_level = 0;             ///< the level at which a matched pair starts

  int places() const { return places_x * places_y; }
  int tiles() const { return tiles_x * tiles_y; }
};

/// The layout for images of a camera.
MatchLayout match_layout(const Camera& camera);

/// Where the parabola through three neighbours is largest: from the one in the middle, -0.5 to 0.5.
double peak(float before, float here, float after);

/// The index of the feature that is matched as number `match`; shaders/search/match_features.glsl.
int matched_feature(int match, int count);

/// 16 normalised numbers that describe 8x8 grey values, or zeros without texture; shaders/search/match_descriptor.glsl.
using MatchDescriptor = std::array<float, 4 * ICLK_MATCH_TEXELS>;
MatchDescriptor describe(const std::array<float, ICLK_PATCH_AREA>& patch);

/// describe() of every place of a map, one per column.
using PlaceDescriptors = Eigen::Matrix<float, 4 * ICLK_MATCH_TEXELS, Eigen::Dynamic, Eigen::RowMajor>;
PlaceDescriptors describe_places(const Map& map, const MatchLayout& layout);

/// The grey map for matching: means of layout.scale x layout.scale pixels of the grey map of level 0.
Map match_map(const Map& grey, const MatchLayout& layout);

/// A matched feature: its point in camera 0, times the mean inverse depth, and its position in image 1.
struct Correspondence {
  Eigen::Vector3d point;
  Eigen::Vector2d pixel;
  float distinct;  ///< score of the best place minus that of the best place elsewhere
};
/// Which rolls of the reference's patches are matched.
enum class Rolls { upright, all };
/// The correspondences of all features that match, the most distinct first. The maps are those of match_map().
std::vector<Correspondence> correspondences(const Map& map0, const Map& map1, const Features& features,
                                            std::span<const FeatureCheck> checks, const Camera& camera,
                                            double mean_inverse_depth, const MatchLayout& layout, Rolls rolls);

/// The share of correspondences that look the same elsewhere in the target.
double repeats(const std::vector<Correspondence>& correspondences);

struct AgreedPose {
  SE3 T_10;
  int agreeing = 0;  ///< correspondences
};
/// The pose with the most agreeing correspondences, among `hypotheses` poses from three correspondences each. Nothing if less
/// than `share` of them agree or the texture repeats. Deterministic.
std::optional<AgreedPose> pose_of(const std::vector<Correspondence>& correspondences, const Camera& camera,
                                  double mean_inverse_depth, const MatchLayout& layout, int hypotheses, double share);

/// Three different random numbers below `count` for hypothesis `number`, the same on every machine. Precondition: count >= 3.
std::array<uint32_t, 3> three_of(uint32_t count, uint32_t number);

struct MatchedStart {
  std::optional<SE3> T_10;
  double repeats = 0;  ///< Ending::repeats
};
/// Finds a start with upright patches, at a fifth of the work; if too few correspondences agree, with all rolls.
MatchedStart matched_start(const Map& map0, const Map& map1, const Features& features, std::span<const FeatureCheck> checks,
                           const Camera& camera, double mean_inverse_depth, const MatchLayout& layout);

}  // namespace iclk::internal
