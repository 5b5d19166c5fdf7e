#pragma once
#include <array>
#include <optional>

#include <Eigen/Core>

#include <iclk/render/date.h>

namespace iclk::internal {

/// The colours of a landscape, RGB in [0, 255].
struct Palette {
  using Colour = Eigen::Vector3d;
  std::array<Colour, 2> meadow;  ///< lush and dry
  std::array<Colour, 6> crops;
  Colour hedge;
  std::array<Colour, 2> crown;   ///< darkest and brightest, of trees that keep their leaves
  std::array<Colour, 2> leaves;  ///< of the other ones
  double bare = 0;               ///< share of ground and branches seen through the other ones
  Colour floor;                  ///< between the crowns
  std::array<Colour, 2> road;
  double snow = 0;
};

/// Without a season: the landscape of early summer in which all trees are alike.
const Palette& palette(const std::optional<Date>& date);

}  // namespace iclk::internal
