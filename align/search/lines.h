#pragma once
#include <optional>

#include <Eigen/Core>

namespace iclk::internal {

/// The lines that an image shows, by place (rows: v, columns: u): their strength times exp(2i direction). Both sides of a line
/// count alike, so it stays what it is where contrasts change their sign, as between seasons.
using Lines = Eigen::MatrixXcf;

/// A motion of the image plane: a turn by `roll` rad and a change of scale about the centre of the map, then a shift.
struct Similarity {
  double roll = 0, scale = 1;
  Eigen::Vector2d centre, shift;

  Eigen::Vector2d operator()(const Eigen::Vector2d& place) const;
};

/// The similarity by which the lines of a whole target agree best with those of a whole reference, in pixels of the maps; first
/// of upright ones, then of all rolls. Nothing unless it is clearly better than any other. Single features may look alike
/// everywhere in such images. Precondition: both maps have one size.
std::optional<Similarity> match_lines(const Lines& reference, const Lines& target, int threads);

}  // namespace iclk::internal
