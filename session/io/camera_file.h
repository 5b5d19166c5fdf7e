#pragma once
#include <string>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/lens.h>
#include <iclk/session/io/text.h>

namespace iclk {

/// A camera as a person states it.
struct CameraFile {
  Camera camera;  ///< width and height 0: not stated, so those of the image
  Distortion distortion;
  double depth_scale = 0;  ///< raw depth units a metre; 0: not stated
  bool region = false;     ///< the size is that of a region of interest: images of another size are not of this camera
  std::string source;      ///< for messages
};

/// "fx,fy,cx,cy[,width,height]", or the path of a file: a camera.txt line "fx fy cx cy width height [depth_scale]", a Kalibr
/// camchain (its first camera) or EuRoC sensor.yaml, an OpenCV or ROS camera YAML (ROS 1 and 2, with region of interest and
/// binning), or a COLMAP cameras.txt with one camera.
/// Throws Error(io) for an unreadable file, Error(invalid_argument) that names file and key otherwise.
CameraFile load_camera(const std::string& text_or_path, const FileReader& read = read_file);

class Yaml;
/// A camera of a YAML file with Kalibr's or EuRoC's keys, each behind `prefix` ("cam1."; EuRoC: ""), or of an OpenCV matrix and
/// its coefficients under these keys (coefficients may be missing). `source` opens the messages. Throws as load_camera().
CameraFile kalibr_camera(const Yaml& yaml, const std::string& prefix, const std::string& source);
CameraFile opencv_camera(const Yaml& yaml, const std::string& matrix, const std::string& coefficients,
                         const std::string& source);
/// The numbers under a key, or under its child `data`. Throws Error(invalid_argument) that names the key: missing, not a
/// number, not finite, not `count` of them.
std::vector<double> yaml_numbers(const Yaml& yaml, const std::string& key, size_t count, const std::string& source);

/// The intrinsics for an image of that size: scaled if the camera was stated for another size of the same aspect.
/// Throws Error(invalid_argument) with both sizes where the aspects differ, and what Camera::check() throws.
Camera fit_camera(const CameraFile& file, int width, int height);

}  // namespace iclk
