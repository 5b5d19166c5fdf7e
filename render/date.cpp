#include <iclk/render/date.h>

#include <cmath>
#include <string>

#include <iclk/engine/error.h>

namespace iclk {
namespace {

constexpr double kDegree = M_PI / 180;

}  // namespace

Date Date::of(Season season, uint64_t year) {
  static constexpr double kSun[][2] = {{140, 42}, {155, 58}, {205, 30}, {165, 16}, {190, 22}};  // azimuth, elevation
  const auto& sun = kSun[static_cast<int>(season)];
  return {season, year, sun[0] * kDegree, sun[1] * kDegree};
}

Eigen::Vector3d Date::to_sun() const {
  const double level = std::cos(sun_elevation);
  return {level * std::sin(sun_azimuth), level * std::cos(sun_azimuth), std::sin(sun_elevation)};
}

void Date::check() const {
  if (!std::isfinite(sun_azimuth) || !(sun_elevation >= 5 * kDegree && sun_elevation <= 90 * kDegree))
    throw Error(ErrorCode::invalid_argument, "date: a sun of azimuth " + std::to_string(sun_azimuth / kDegree) +
                                                 " and elevation " + std::to_string(sun_elevation / kDegree) +
                                                 " degrees; the elevation must be 5 to 90");
}

}  // namespace iclk
