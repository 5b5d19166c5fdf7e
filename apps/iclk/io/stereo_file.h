#pragma once
#include <string>
#include <utility>
#include <vector>

#include <iclk/align/se3.h>
#include <iclk/session/io/camera_file.h>

namespace iclk {

/// The calibration of a stereo rig.
struct StereoFile {
  enum class Format { kalibr, euroc, opencv };
  Format format = Format::kalibr;
  CameraFile left, right;
  SE3 T_rl;  ///< left camera to right camera
  SE3 T_bl;  ///< left camera to body; identity where the format has none
  /// Files as they were read: the name under which a new one is written, and the text. EuRoC: cam0/sensor.yaml, cam1/...
  std::vector<std::pair<std::string, std::string>> files;
};

/// A Kalibr camchain (cam0 is the left camera, cam1 the right one with T_cn_cnm1), a folder with EuRoC's cam0/sensor.yaml and
/// cam1/sensor.yaml (T_BS), or an OpenCV YAML with M1, D1, M2, D2, R, T as stereoCalibrate() has them (also cameraMatrix1,
/// distCoeffs1, K1, ...), or its intrinsics.yml and extrinsics.yml, of which either or their folder is given. Throws Error(io)
/// for unreadable files, Error(invalid_argument) that names file and key.
StereoFile load_stereo(const std::string& path);

/// The same files with other extrinsics of the right camera (Kalibr: T_cn_cnm1, and T_cam_imu where both cameras have one); all
/// else as it was, comments too. What OpenCV derived from the old pose (E, F, R1, R2, P1, P2, Q) is left out.
std::vector<std::pair<std::string, std::string>> with_extrinsics(const StereoFile& file, const SE3& T_rl);

}  // namespace iclk
