#pragma once
#include <optional>
#include <string>

#include <Eigen/Core>

#include <iclk/session/io/camera_file.h>

namespace iclk {

/// What the file of a picture states about its camera: EXIF, and XMP as drones write it. `..._from` names the source.
struct PictureMetadata {
  std::optional<Eigen::Vector2d> lat_lon;  ///< degrees, WGS 84
  std::optional<double> altitude;          ///< m; what it counts from is the maker's choice
  std::optional<double> height;            ///< m, above the ground or the take-off point
  std::optional<Eigen::Matrix3d> R_WC;     ///< camera to east, north, up at the place
  std::optional<CameraFile> camera;        ///< the maker's calibration of this very camera
  bool ellipsoid = false;                  ///< EXIF states that `altitude` counts from the ellipsoid
  std::string lat_lon_from, altitude_from, height_from, attitude_from;
  std::string no_place, no_attitude,
      no_camera =
          "it has no calibration of its camera (DewarpData)";  ///< why there is none, such as "its GPS position is 0, 0"
};

/// Never throws for what the file states, or does not: values that cannot be true are left out. Namespaces of XMP are known by
/// their usual prefixes.
PictureMetadata read_metadata(const std::string& path);

}  // namespace iclk
