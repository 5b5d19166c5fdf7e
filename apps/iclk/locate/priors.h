#pragma once
#include <array>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/se3.h>
#include <iclk/locate/locator.h>
#include <iclk/render/geotiff.h>

namespace iclk {

/// Standard deviations of a prior, as users give them.
struct PriorSigmas {
  double position = 10, angle = 5;        ///< m, degrees
  std::optional<double> height, heading;  ///< m, degrees; none: those of position and angle

  /// Throws the errors of LocatePrior::check().
  LocatePrior around(const SE3& T_WC) const;
};

/// What the height of a prior counts from.
enum class Altitude { map, ground, ellipsoid };
inline constexpr std::array<const char*, 3> kAltitudes = {"map", "ground", "ellipsoid"};  // by Altitude

/// Where priors come from.
struct PriorOptions {
  std::string source;             ///< a file; "LAT,LON,Z", or "X,Y,Z" on a map that is nowhere on earth; empty: the pictures
  std::optional<double> heading;  ///< degrees, of three numbers; none: unknown
  std::optional<double> pitch;    ///< degrees, of three numbers; none: -90
  Altitude altitude = Altitude::map;
  std::optional<double> geoid;  ///< m above the ellipsoid, for Altitude::ellipsoid
  PriorSigmas sigmas;
};

/// The prior of one picture.
struct FramePrior {
  std::string image;  ///< the name of its file; empty: `time` names it
  double time = 0;
  LocatePrior prior;
};

/// The prior that three numbers are; nothing if `options.source` is no three numbers. Throws Error(invalid_argument) for a
/// place that the map's system does not cover, and for a heading or pitch without three numbers.
std::optional<LocatePrior> first_prior(const PriorOptions& options, const MapSystem& map);

/// Reads the poses of pictures from a CSV file with a header, or TUM lines "time tx ty tz qx qy qz qw" of T_WC.
///
///   image               the file's name, with or without folder
///   x,y,z               on the map, m; or lat,lon,z: degrees, WGS 84
///   yaw,pitch,roll      degrees: clockwise from north, up from the horizon, clockwise about the optical axis
///   omega,phi,kappa     degrees, photogrammetry's: R = Rx(omega) Ry(phi) Rz(kappa), z backward
///   sigma, sigma_z, sigma_angle, sigma_heading      instead of those of the options, as far as they are there
///
/// Throws Error(io), and Error(invalid_argument) "`file`:`line`: ..." for a missing column or a bad value.
std::vector<FramePrior> load_priors(const PriorOptions& options, const MapSystem& map);

struct PictureMetadata;
/// The prior that a picture's file states. `why`: what it lacks, if nothing is returned.
std::optional<LocatePrior> stated_prior(const PictureMetadata& stated, const PriorOptions& options, const MapSystem& map,
                                        std::string& why);

/// Counts the height of a prior as the map does. `ground`: height of the map below the camera. False if that is needed and is
/// nothing.
bool to_map_height(LocatePrior& prior, const PriorOptions& options, const std::optional<double>& ground);

/// Camera to map, from degrees.
Eigen::Matrix3d from_yaw_pitch_roll(const Eigen::Vector3d& degrees);
Eigen::Matrix3d from_omega_phi_kappa(const Eigen::Vector3d& degrees);
/// The inverse functions. At a pitch of 90 degrees roll is 0.
Eigen::Vector3d yaw_pitch_roll(const Eigen::Matrix3d& R_WC);
Eigen::Vector3d omega_phi_kappa(const Eigen::Matrix3d& R_WC);

}  // namespace iclk
