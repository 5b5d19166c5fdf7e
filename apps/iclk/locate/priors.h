#pragma once
#include <string>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/se3.h>
#include <iclk/render/geotiff.h>

namespace iclk {

/// The prior pose of one picture.
struct FramePrior {
  std::string image;  ///< the name of its file; empty: `time` names it
  double time = 0;
  SE3 T_WC;
};

/// Reads the poses of pictures from a CSV file with a header, or TUM lines "time tx ty tz qx qy qz qw" of T_WC.
///
///   image               the file's name, with or without folder
///   x,y,z               on the map, m; or lat,lon,z: degrees, WGS 84. z: as the elevation model counts heights
///   yaw,pitch,roll      degrees: clockwise from north, up from the horizon, clockwise about the optical axis
///   omega,phi,kappa     degrees, photogrammetry's: R = Rx(omega) Ry(phi) Rz(kappa), z backward
///
/// Throws Error(io), and Error(invalid_argument) "`file`:`line`: ..." for a missing column or a bad value.
std::vector<FramePrior> load_priors(const std::string& path, const MapSystem& map);

/// Camera to map, from degrees.
Eigen::Matrix3d from_yaw_pitch_roll(const Eigen::Vector3d& degrees);
Eigen::Matrix3d from_omega_phi_kappa(const Eigen::Vector3d& degrees);
/// The inverse functions. At a pitch of 90 degrees roll is 0.
Eigen::Vector3d yaw_pitch_roll(const Eigen::Matrix3d& R_WC);
Eigen::Vector3d omega_phi_kappa(const Eigen::Matrix3d& R_WC);

}  // namespace iclk
