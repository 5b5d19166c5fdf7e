#pragma once
#include <string>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/lens.h>
#include <iclk/session/io/text.h>

namespace iclk {

/// The contents of a camera file.
struct CameraFile {
  Camera camera;  ///< width and height 0: not stated; use those of the image
  Distortion distortion;
  double depth_scale = 0;  ///< raw depth units per metre; 0: not stated
  bool region = false;     ///< the size is that of a region of interest: images of other sizes do not fit
  std::string source;      ///< for messages
};

/// Loads a camera from a text "fx,fy,cx,cy[,width,height]" or from a file. The file may be a camera.txt with a line "fx fy cx
/// cy width height [depth_scale]". It may be a Kalibr camchain (its first camera), an EuRoC sensor.yaml, or a COLMAP
/// cameras.txt with one camera. It may also be an OpenCV or ROS camera YAML (ROS 1 and 2, with region of interest and binning).
/// Throws Error(io) for an unreadable file, else Error(invalid_argument) that names file and key.
CameraFile load_camera(const std::string& text_or_path, const FileReader& read = read_file);

class Yaml;
/// Reads a camera with the keys of Kalibr or EuRoC, each preceded by `prefix` ("cam1."; EuRoC: ""). Messages begin with
/// `source`. Throws the errors of load_camera().
CameraFile kalibr_camera(const Yaml& yaml, const std::string& prefix, const std::string& source);
/// Reads an OpenCV camera; `matrix` and `coefficients` are the keys, and the coefficients may be missing. Messages begin with
/// `source`. Throws the errors of load_camera().
CameraFile opencv_camera(const Yaml& yaml, const std::string& matrix, const std::string& coefficients,
                         const std::string& source);
/// The numbers of a key, or of its child `data`. Throws Error(invalid_argument) that names the key if it is missing, has
/// values that are not finite numbers, or not `count` of them.
std::vector<double> yaml_numbers(const Yaml& yaml, const std::string& key, size_t count, const std::string& source);

/// The intrinsics for an image of this size, scaled if the file states another size of the same aspect ratio.
/// Throws Error(invalid_argument) with both sizes if the aspect ratios differ, and the errors of Camera::check().
Camera fit_camera(const CameraFile& file, int width, int height);

}  // namespace iclk
