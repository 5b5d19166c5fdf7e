#include "apps/iclk/locate/priors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <set>

#include <Eigen/Geometry>

#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/locate/metadata.h"

namespace iclk {
namespace {

Eigen::Matrix3d turn(const Eigen::Vector3d& axis, double degrees) {
  return Eigen::AngleAxisd(degrees * kDegree, axis).toRotationMatrix();
}

/// A level camera that looks north.
Eigen::Matrix3d north() {
  Eigen::Matrix3d R;
  R << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  return R;
}

using Columns = std::array<int, 3>;
constexpr std::array<const char*, 4> kSigmas = {"sigma", "sigma_z", "sigma_angle", "sigma_heading"};

/// Turns from north to the map's y axis at a place: the axis is that of the grid, and only some of its lines lead north.
Eigen::Matrix3d grid_from_north(const MapSystem& map, const Eigen::Vector2d& lat_lon) {
  constexpr double kStep = 1e-4;                         // degrees, 11 m
  const double step = lat_lon.x() > 0 ? -kStep : kStep;  // away from the pole, where there is no north
  const auto a = map.place(lat_lon.x(), lat_lon.y()), b = map.place(lat_lon.x() + step, lat_lon.y());
  if (!a || !b) return Eigen::Matrix3d::Identity();
  const Eigen::Vector2d north = (*b - *a) / step;
  return Eigen::AngleAxisd(-std::atan2(north.x(), north.y()), Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

/// The place on the map, or nothing.
std::optional<Eigen::Vector2d> place_of(const MapSystem& map, double latitude, double longitude) {
  return std::abs(latitude) <= 90 && std::abs(longitude) <= 360 ? map.place(latitude, longitude) : std::nullopt;
}

/// Reads the lines of a CSV file of poses.
class PriorTable {
 public:
  PriorTable(const PriorOptions& options, const MapSystem& map) : path_(options.source), map_(map), sigmas_(options.sigmas) {}

  std::vector<FramePrior> read(std::string_view text) {
    std::vector<FramePrior> priors;
    for (const std::string_view line : lines_of(text)) {
      ++number_;
      if (without_comment(line).empty()) continue;
      const std::vector<std::string> cells = split_cells(line);
      if (image_ < 0)
        header(cells);
      else
        priors.push_back(prior(cells));
    }
    if (priors.empty()) refuse(path_ + ": has no pose");
    return priors;
  }

 private:
  [[noreturn]] void fail(const std::string& why) const { refuse(path_ + ":" + std::to_string(number_) + ": " + why); }

  void header(const std::vector<std::string>& cells) {
    const auto find = [&](const char* name) {
      return static_cast<int>(std::find(cells.begin(), cells.end(), name) - cells.begin());
    };
    const auto count = static_cast<int>(cells.size());
    const auto columns = [&](const char* a, const char* b, const char* c) -> std::optional<Columns> {
      const Columns all = {find(a), find(b), find(c)};
      return std::all_of(all.begin(), all.end(), [&](int i) { return i < count; }) ? std::optional(all) : std::nullopt;
    };
    const auto metres = columns("x", "y", "z"), degrees = columns("lat", "lon", "z");
    const auto drone = columns("yaw", "pitch", "roll"), survey = columns("omega", "phi", "kappa");
    if (find("image") == count || metres.has_value() == degrees.has_value() || drone.has_value() == survey.has_value())
      fail("the header must have 'image', either 'x,y,z' or 'lat,lon,z', and either 'yaw,pitch,roll' or 'omega,phi,kappa'");
    image_ = find("image"), count_ = cells.size();
    for (size_t i = 0; i < kSigmas.size(); ++i) sigma_columns_[i] = find(kSigmas[i]);
    on_earth_ = degrees.has_value(), position_ = on_earth_ ? *degrees : *metres;
    survey_ = survey.has_value(), attitude_ = survey_ ? *survey : *drone;
    if (on_earth_ && !map_.on_earth()) fail("'lat,lon' cannot be placed: the map names no system of coordinates; give 'x,y'");
  }

  double number(const std::string& cell) const {
    const auto value = to_number(cell);
    if (!value || !std::isfinite(*value)) fail("'" + printable(cell) + "' is not a number");
    return *value;
  }

  Eigen::Vector3d numbers(const std::vector<std::string>& cells, const Columns& columns) const {
    Eigen::Vector3d all;
    for (size_t i = 0; i < 3; ++i) all[static_cast<int>(i)] = number(cells[static_cast<size_t>(columns[i])]);
    return all;
  }

  PriorSigmas sigmas(const std::vector<std::string>& cells) const {
    PriorSigmas all = sigmas_;
    const auto set = [&](size_t i, auto& sigma) {
      if (sigma_columns_[i] == static_cast<int>(count_)) return;
      const double value = number(cells[static_cast<size_t>(sigma_columns_[i])]);
      if (value < 0) fail(std::string(kSigmas[i]) + " is below 0");
      sigma = value;
    };
    set(0, all.position), set(1, all.height), set(2, all.angle), set(3, all.heading);
    return all;
  }

  FramePrior prior(const std::vector<std::string>& cells) {
    if (cells.size() != count_) fail("has " + std::to_string(cells.size()) + " values, the header " + std::to_string(count_));
    FramePrior prior;
    prior.image = cells[static_cast<size_t>(image_)];
    if (prior.image.empty()) fail("names no image");
    if (!names_.insert(prior.image.substr(prior.image.find_last_of('/') + 1)).second)
      fail("a second pose of " + printable(prior.image));
    SE3 T_WC;
    T_WC.t = numbers(cells, position_);
    if (on_earth_) {
      const double latitude = T_WC.t.x(), longitude = T_WC.t.y();
      const auto place = place_of(map_, latitude, longitude);
      if (!place)
        fail("latitude " + std::to_string(latitude) + " and longitude " + std::to_string(longitude) + " are not on the map");
      T_WC.t.head<2>() = *place;
    }
    const Eigen::Vector3d degrees = numbers(cells, attitude_);
    T_WC.R = survey_ ? from_omega_phi_kappa(degrees) : from_yaw_pitch_roll(degrees);
    prior.prior = sigmas(cells).around(T_WC);
    return prior;
  }

  std::string path_;
  const MapSystem& map_;
  int number_ = 0, image_ = -1;
  size_t count_ = 0;
  bool on_earth_ = false, survey_ = false;
  Columns position_{}, attitude_{};
  PriorSigmas sigmas_;
  std::array<int, kSigmas.size()> sigma_columns_{};
  std::set<std::string> names_;  // of files, without folders
};

}  // namespace

Eigen::Matrix3d from_yaw_pitch_roll(const Eigen::Vector3d& degrees) {
  return turn(Eigen::Vector3d::UnitZ(), -degrees.x()) * turn(Eigen::Vector3d::UnitX(), degrees.y()) * north() *
         turn(Eigen::Vector3d::UnitZ(), degrees.z());
}

Eigen::Matrix3d from_omega_phi_kappa(const Eigen::Vector3d& degrees) {
  return turn(Eigen::Vector3d::UnitX(), degrees.x()) * turn(Eigen::Vector3d::UnitY(), degrees.y()) *
         turn(Eigen::Vector3d::UnitZ(), degrees.z()) * Eigen::Vector3d(1, -1, -1).asDiagonal();
}

Eigen::Vector3d yaw_pitch_roll(const Eigen::Matrix3d& R_WC) {
  const Eigen::Vector3d axis = R_WC.col(2), up = -R_WC.col(1);
  // Looking straight down or up, the top of the picture tells where ahead is.
  const bool level = std::hypot(axis.x(), axis.y()) > 1e-6;
  const Eigen::Vector3d ahead = level ? axis : Eigen::Vector3d(axis.z() < 0 ? up : Eigen::Vector3d(-up));
  Eigen::Vector3d degrees(std::atan2(ahead.x(), ahead.y()), std::asin(std::clamp(axis.z(), -1.0, 1.0)), 0);
  degrees /= kDegree;
  const Eigen::Matrix3d rest = from_yaw_pitch_roll(degrees).transpose() * R_WC;
  degrees.z() = std::atan2(rest(1, 0), rest(0, 0)) / kDegree;
  return degrees;
}

Eigen::Vector3d omega_phi_kappa(const Eigen::Matrix3d& R_WC) {
  const Eigen::Matrix3d R = R_WC * Eigen::Vector3d(1, -1, -1).asDiagonal();
  return Eigen::Vector3d(std::atan2(-R(1, 2), R(2, 2)), std::asin(std::clamp(R(0, 2), -1.0, 1.0)),
                         std::atan2(-R(0, 1), R(0, 0))) /
         kDegree;
}

LocatePrior PriorSigmas::around(const SE3& T_WC) const {
  LocatePrior prior{T_WC, position, height.value_or(position), angle * kDegree, heading.value_or(angle) * kDegree};
  prior.check();
  return prior;
}

std::optional<LocatePrior> first_prior(const PriorOptions& options, const MapSystem& map) {
  std::vector<double> numbers;
  for (const std::string& cell : split_cells(options.source))
    if (const auto value = to_number(cell); value && std::isfinite(*value)) numbers.push_back(*value);
  if (numbers.size() != 3 || split_cells(options.source).size() != 3) {
    if (options.heading || options.pitch) refuse("--heading and --pitch need --prior LAT,LON,Z; other priors have an attitude");
    return std::nullopt;
  }
  SE3 T_WC;
  T_WC.t = Eigen::Map<Eigen::Vector3d>(numbers.data());
  if (map.on_earth()) {
    const auto place = place_of(map, numbers[0], numbers[1]);
    if (!place)
      refuse("--prior " + options.source +
             ": this is no LAT,LON,Z of the map, which has a system of coordinates; give x,y,z in a CSV file");
    T_WC.t.head<2>() = *place;
  }
  T_WC.R = from_yaw_pitch_roll({options.heading.value_or(0), options.pitch.value_or(-90), 0});
  PriorSigmas sigmas = options.sigmas;
  if (!options.heading) sigmas.heading = 180;
  return sigmas.around(T_WC);
}

std::vector<FramePrior> load_priors(const PriorOptions& options, const MapSystem& map) {
  const std::string& path = options.source;
  const std::string text = read_file(path, size_t{256} << 20);
  for (const std::string_view line : lines_of(text)) {
    const std::string_view first = without_comment(line);
    if (first.empty()) continue;
    if (first.find(',') != std::string_view::npos) return PriorTable(options, map).read(text);
    break;
  }
  std::vector<FramePrior> priors;
  for (const StampedPose& pose : load_trajectory(path)) priors.push_back({"", pose.stamp, options.sigmas.around(pose.T_wc)});
  return priors;
}

std::optional<LocatePrior> stated_prior(const PictureMetadata& stated, const PriorOptions& options, const MapSystem& map,
                                        std::string& why) {
  const bool ground = options.altitude == Altitude::ground;
  const std::optional<double>& z = ground ? stated.height : stated.altitude;
  const auto place = stated.lat_lon ? place_of(map, stated.lat_lon->x(), stated.lat_lon->y()) : std::nullopt;
  why = !stated.lat_lon ? stated.no_place : !stated.R_WC ? stated.no_attitude : "";
  if (why.empty() && !map.on_earth()) why = "the map names no system of coordinates, in which its GPS position could lie";
  if (why.empty() && !place) why = "its GPS position is outside of what the map's system covers";
  if (why.empty() && !z) why = ground ? "it has no height above the ground (RelativeAltitude)" : "it has no altitude";
  if (why.empty() && stated.ellipsoid && options.altitude == Altitude::map)
    why = "its altitude counts from the ellipsoid; give --altitude ellipsoid and --geoid";
  if (!why.empty()) return std::nullopt;
  return options.sigmas.around({grid_from_north(map, *stated.lat_lon) * *stated.R_WC, {place->x(), place->y(), *z}});
}

bool to_map_height(LocatePrior& prior, const PriorOptions& options, const std::optional<double>& ground) {
  double& z = prior.T_WC.t.z();
  if (options.altitude == Altitude::ellipsoid) z -= options.geoid.value();
  if (options.altitude != Altitude::ground) return true;
  if (ground) z += *ground;
  return ground.has_value();
}

}  // namespace iclk
