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

/// Sizes of a start by matching (AlignerOptions::search). Pure arithmetic.
struct MatchLayout {
  MatchLayout() = default;
  MatchLayout(const Plan& plan, const AlignerOptions& options);

  bool enabled = false;            ///< false too where the images are too small for it
  int scale = 1;                   ///< image pixels a pixel of the grey map that is matched
  int width = 0, height = 0;       ///< of that map
  int places_x = 0, places_y = 0;  ///< of a patch in it
  int tiles_x = 0, tiles_y = 0;    ///< of places
  int features = 0;                ///< of a reference that take part, at most
  int first_level = 0;             ///< where a pair begins that was matched

  int places() const { return places_x * places_y; }
  int tiles() const { return tiles_x * tiles_y; }
};

/// Number of the feature that takes part as number `match`; shaders/search/match_features.glsl.
int matched_feature(int match, int count);

/// 8x8 grey values -> 16 numbers, normalised, or all zero where there is no texture; shaders/search/match_descriptor.glsl.
using MatchDescriptor = std::array<float, 4 * ICLK_MATCH_TEXELS>;
MatchDescriptor describe(const std::array<float, ICLK_PATCH_AREA>& patch);

/// describe() of every place of a map, one a column.
using PlaceDescriptors = Eigen::Matrix<float, 4 * ICLK_MATCH_TEXELS, Eigen::Dynamic, Eigen::RowMajor>;
PlaceDescriptors describe_places(const Map& map, const MatchLayout& layout);

/// Means of squares of `layout.scale` pixels of a grey map of level 0.
Map match_map(const Map& grey, const MatchLayout& layout);

/// A point of camera 0, times the mean inverse depth, and where image 1 shows it.
struct Correspondence {
  Eigen::Vector3d point;
  Eigen::Vector2d pixel;
  float distinct;  ///< score of the best place less that of the best one elsewhere
};
/// Patches of the reference that are looked for.
enum class Rolls { upright, all };
/// Of every feature that has a place, the most distinct first. Maps as match_map() makes them.
std::vector<Correspondence> correspondences(const Map& map0, const Map& map1, const Features& features,
                                            std::span<const FeatureCheck> checks, const Camera& camera,
                                            double mean_inverse_depth, const MatchLayout& layout, Rolls rolls);

/// Share of them that look the same elsewhere in the target.
double repeats(const std::vector<Correspondence>& correspondences);

/// The pose that most of them agree with, of as many from three each; none if less than a `share` does or the texture repeats.
/// Deterministic.
std::optional<SE3> pose_of(const std::vector<Correspondence>& correspondences, const Camera& camera, double mean_inverse_depth,
                           const MatchLayout& layout, int hypotheses, double share);

/// Three different numbers below `count`, at least 3, drawn for hypothesis `number`: the same on every machine.
std::array<uint32_t, 3> three_of(uint32_t count, uint32_t number);

struct MatchedStart {
  std::optional<SE3> T_10;
  double repeats = 0;  ///< Ending::repeats
};
/// First by patches that are not rolled, at a fifth of the work; where too few of them agree, by all rolls.
MatchedStart matched_start(const Map& map0, const Map& map1, const Features& features, std::span<const FeatureCheck> checks,
                           const Camera& camera, double mean_inverse_depth, const MatchLayout& layout);

}  // namespace iclk::internal
