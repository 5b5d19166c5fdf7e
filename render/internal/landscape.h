#pragma once
#include <cstdint>
#include <optional>

#include <Eigen/Core>

#include <iclk/render/date.h>
#include <iclk/render/internal/palette.h>

namespace iclk::internal {

/// Heights and colours of a procedural landscape.
class Landscape {
 public:
  using Colour = Eigen::Vector3d;

  Landscape(uint64_t seed, double relief, const std::optional<Date>& date);

  /// The height, including roofs and crowns.
  double surface(double x, double y) const;
  /// RGB, to be clamped to [0, 255]. `normal`: of the surface; `sunlit`: the share of the sun that is not hidden.
  Colour colour(double x, double y, const Eigen::Vector3d& normal, double sunlit) const;
  /// From the ground to the sun.
  const Eigen::Vector3d& sun() const { return sun_; }

 private:
  /// A house on its lot.
  struct House {
    bool inside = false;
    double across = 0, along = 0;  // m, across and along the ridge
    double half_width = 0, half_length = 0, wall = 0;
    double angle = 0;  // rad, of the ridge
    uint32_t kind = 0;
  };
  /// The crown of the nearest tree.
  struct Crown {
    double radius = 0, distance = 0;  // m
    uint32_t kind = 0;
  };
  /// The middle of the nearest road.
  struct Road {
    double off = 0;                // m
    double across = 0, along = 0;  // m, in the crooked grid
    bool north = false;
  };

  double ground(double x, double y) const;
  Road road(double x, double y) const;
  House house_at(double x, double y) const;
  double wood_at(double x, double y) const;
  Crown crown_at(double x, double y) const;

  Colour light(const Eigen::Vector3d& normal, double sunlit) const;
  Colour roof(const House& house, double sunlit) const;
  Colour road_colour(double x, double y, double off) const;
  std::optional<Colour> car(const Road& road) const;
  Colour wood_colour(double x, double y) const;
  Colour field(double x, double y, const Colour& meadow) const;
  Colour snowed(double x, double y, const Colour& c, double share) const;

  double relief_;
  uint32_t salt_;
  std::optional<Date> date_;
  uint32_t season_salt_ = 0, year_salt_ = 0;  ///< of what season and year change
  Eigen::Vector3d sun_;
  const Palette& palette_;
};

}  // namespace iclk::internal
