#pragma once
#include <cstdint>

#include <opencv2/core.hpp>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk {

/// A pair with exact truth.
struct ScenePair {
  Camera camera;
  cv::Mat image_0, image_1;  ///< CV_8UC3, BGR
  cv::Mat depth_0, depth_1;  ///< CV_32FC1, metres, of each camera
  SE3 T_10;                  ///< truth
};

struct SceneOptions {
  int width = 640, height = 480;
  uint64_t seed = 1;   ///< of the noise in both images
  double gain = 0.82;  ///< exposure of the target: I1 = gain I0 + bias
  double bias = 14;    ///< grey values of 255
  double noise = 1.5;  ///< standard deviation, grey values of 255
};

/// A model landscape of 2 m x 2 m with hills of up to 0.35 m, seen from 2 m above: a height field with texture from 1 cm to 1
/// m, drawn by ray casting from camera 0 (looking straight down) and from camera 1. Precondition: T_10 keeps camera 1 above the
/// hills.
ScenePair make_scene_pair(const SE3& T_10, const SceneOptions& options = {});

/// A motion that suits it: 3 degrees and 6 cm.
SE3 demo_motion();

}  // namespace iclk
