#pragma once
#include <complex>
#include <optional>

#include <iclk/align/pyramid.h>
#include <Eigen/Core>

namespace iclk::internal {

/// The lines that an image shows, by place (rows: v, columns: u): their strength times exp(2i direction). Both sides of a line
/// count alike, so it stays what it is where contrasts change their sign, as between seasons.
using Lines = Eigen::MatrixXcf;

/// The lines of an image, means over squares of `scale` pixels. Hidden, infinite and NaN pixels have none.
Lines lines_of(const Map& grey, int scale);

/// The lines that differ from those within `around` pixels to either side, each at most 1: less their mean, over their
/// deviation. A wood has lines everywhere, a ploughed field many of one direction.
Lines distinct(const Lines& lines, Eigen::Index around);

/// The lines at a place between the pixels. Zero beyond the border.
std::complex<float> sample(const Lines& lines, const Eigen::Vector2d& at);

/// A motion of the image plane: a turn by `roll` rad and a change of scale about `centre`, then a shift.
struct Similarity {
  double roll = 0, scale = 1;
  Eigen::Vector2d centre, shift;

  Eigen::Vector2d operator()(const Eigen::Vector2d& place) const;
};

/// The similarity by which the lines of a whole target agree best with those of a whole reference, in pixels of the maps; first
/// of upright ones, then of all rolls. Nothing unless it is clearly better than any other. Precondition: both maps have one
/// size.
std::optional<Similarity> match_lines(const Lines& reference, const Lines& target, int threads);

}  // namespace iclk::internal
