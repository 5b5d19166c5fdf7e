#pragma once
#include <cstdint>

#include <Eigen/Core>

namespace iclk {

enum class Season { spring, summer, autumn, winter, snow };

/// When a place is photographed. Two dates of one place differ in colours, crops, cars and shadows. Ground, houses and crowns
/// have the same heights.
struct Date {
  Season season = Season::summer;
  uint64_t year = 0;           ///< draws crops, growth and cars; equal years of two seasons differ too
  double sun_azimuth = 2.8;    ///< rad clockwise from north
  double sun_elevation = 0.9;  ///< rad above the horizon

  /// The usual sun of a season, before noon in central Europe.
  static Date of(Season season, uint64_t year = 0);
  /// From the ground to the sun, x east, y north, z up; length 1.
  Eigen::Vector3d to_sun() const;
  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

}  // namespace iclk
