#pragma once
#include <map>
#include <optional>
#include <span>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/align/search/lines.h>
#include <iclk/align/search/matching.h>

namespace iclk::internal {

/// The patches of lines of a pair at one scale, 25x25 pixels of the maps.
class LinePatches {
 public:
  /// A patch that was compared. It has no match if it looks most like a place at the border of those around: its own may be
  /// farther away.
  struct Compared {
    std::optional<Correspondence> match;
  };

  /// `scale`: image pixels per pixel of the maps. `target`: its hidden pixels have no lines (hide()).
  LinePatches(const Map& reference, const Map& target, int scale);

  /// The place in the target of the patch around a feature, warped by a pose, within `reach` (at most 8) pixels of the maps.
  /// Nothing if the patch is not inside the target, or has no lines. `match` has the point on the feature's ray at depth 1.
  std::optional<Compared> find(const Camera& camera, const Eigen::Vector2d& uv, double inverse_depth, const SE3& T_10,
                               int reach) const;

 private:
  Lines known_;
  Eigen::MatrixXf real_, imag_;  // of the target, with a border of zeros
  int scale_;
};

/// The patches of lines of a pair, made once a scale. Precondition: the images of the reference and the pair have one size.
class PairLines {
 public:
  PairLines(const Reference& reference, const Pair& pair);
  const LinePatches& at(int scale);

 private:
  Map reference_, target_;
  std::map<int, LinePatches> patches_;
};

/// A round of match_line_patches().
struct LineRound {
  int scale = 1;        ///< image pixels per pixel of the maps
  int reach = 6;        ///< pixels of the maps around the expected places
  double share = 0.25;  ///< of the patches, which must agree
};

/// A pose on which patches of lines agree.
struct LinePose {
  SE3 T_10;
  int agreeing = 0, compared = 0;  ///< patches, in the last round
  double share() const { return compared > 0 ? static_cast<double>(agreeing) / compared : 0; }
};

/// The rounds from a start that is up to 8 pixels of the matched map off: two at its scale, and two finer ones. Precondition:
/// the camera's images are large enough to be matched (MatchLayout::enabled).
std::vector<LineRound> line_rounds(const Camera& camera);

/// A pose near `start`. Each feature's patch of lines is warped by the pose and compared with the places around the expected
/// one, round by round. Patches have 25x25 pixels of the maps. Nothing if too few agree in any round. Precondition: `lines` are
/// of a pair of this reference, whose images have the size of its camera.
std::optional<LinePose> match_line_patches(const Reference& reference, std::span<const FeatureCheck> checks, PairLines& lines,
                                           const SE3& start, std::span<const LineRound> rounds, int threads);

}  // namespace iclk::internal
