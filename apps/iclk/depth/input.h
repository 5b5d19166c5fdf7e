#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/depth/depth_options.h>
#include <iclk/session/io/camera_file.h>

namespace iclk {

class Undistorter;

/// What `iclk depth` is given, as text and files.
struct DepthFiles {
  std::string reference;
  std::vector<std::string> targets;
  std::vector<std::string> poses;  ///< T_10, one a target
  std::string pose_file;           ///< a line a target
  std::string result;              ///< of iclk align: pose and features
  std::string camera, target_camera, distortion;
  std::string features, depth;  ///< sparse depths, or a depth image
  double depth_scale = 0;
  bool depth_along_ray = false;  ///< of features and depth: distances from the camera's centre
  std::string range;             ///< NEAR,FAR in metres
};

/// As pinhole cameras would have seen it; the reference and every target have one size.
struct DepthInput {
  cv::Mat reference;
  Camera camera;
  std::vector<cv::Mat> targets;
  std::vector<Camera> cameras;  ///< one a target
  std::vector<SE3> T_10;        ///< one a target
  Features priors;
  Features measured;  ///< of the depth image, which is no prior
  DepthRange range;
  std::shared_ptr<const Undistorter> lens;  ///< of the reference's camera; null: it is a pinhole
};

/// Throws Error that names the file or the option: a pose is missing, sizes differ, no range is given and no depth tells it.
DepthInput load_depth_input(const DepthFiles& files);

}  // namespace iclk
