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

/// Reads the lines of a CSV file of poses.
class PriorTable {
 public:
  PriorTable(std::string path, const MapSystem& map) : path_(std::move(path)), map_(map) {}

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
    on_earth_ = degrees.has_value(), position_ = on_earth_ ? *degrees : *metres;
    survey_ = survey.has_value(), attitude_ = survey_ ? *survey : *drone;
    if (on_earth_ && !map_.on_earth()) fail("'lat,lon' cannot be placed: the map names no system of coordinates; give 'x,y'");
  }

  Eigen::Vector3d numbers(const std::vector<std::string>& cells, const Columns& columns) const {
    Eigen::Vector3d all;
    for (size_t i = 0; i < 3; ++i) {
      const std::string& cell = cells[static_cast<size_t>(columns[i])];
      const auto value = to_number(cell);
      if (!value || !std::isfinite(*value)) fail("'" + printable(cell) + "' is not a number");
      all[static_cast<int>(i)] = *value;
    }
    return all;
  }

  FramePrior prior(const std::vector<std::string>& cells) {
    if (cells.size() != count_) fail("has " + std::to_string(cells.size()) + " values, the header " + std::to_string(count_));
    FramePrior prior;
    prior.image = cells[static_cast<size_t>(image_)];
    if (prior.image.empty()) fail("names no image");
    if (!names_.insert(prior.image.substr(prior.image.find_last_of('/') + 1)).second)
      fail("a second pose of " + printable(prior.image));
    prior.T_WC.t = numbers(cells, position_);
    if (on_earth_) {
      const double latitude = prior.T_WC.t.x(), longitude = prior.T_WC.t.y();
      const auto place =
          std::abs(latitude) <= 90 && std::abs(longitude) <= 360 ? map_.place(latitude, longitude) : std::nullopt;
      if (!place)
        fail("latitude " + std::to_string(latitude) + " and longitude " + std::to_string(longitude) + " are not on the map");
      prior.T_WC.t.head<2>() = *place;
    }
    const Eigen::Vector3d degrees = numbers(cells, attitude_);
    prior.T_WC.R = survey_ ? from_omega_phi_kappa(degrees) : from_yaw_pitch_roll(degrees);
    return prior;
  }

  std::string path_;
  const MapSystem& map_;
  int number_ = 0, image_ = -1;
  size_t count_ = 0;
  bool on_earth_ = false, survey_ = false;
  Columns position_{}, attitude_{};
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

std::vector<FramePrior> load_priors(const std::string& path, const MapSystem& map) {
  const std::string text = read_file(path, size_t{256} << 20);
  for (const std::string_view line : lines_of(text)) {
    const std::string_view first = without_comment(line);
    if (first.empty()) continue;
    if (first.find(',') != std::string_view::npos) return PriorTable(path, map).read(text);
    break;
  }
  std::vector<FramePrior> priors;
  for (const StampedPose& pose : load_trajectory(path)) priors.push_back({"", pose.stamp, pose.T_wc});
  return priors;
}

}  // namespace iclk
