#pragma once
#include <string>

#include <opencv2/core.hpp>

#include <iclk/align/camera.h>
#include <iclk/depth/depth_sweep.h>

namespace iclk {

/// CV_32FC1 metres along the optical axis, 0: none.
cv::Mat depth_image(const DepthMap& map);

/// iclk::fill() of an image of depths.
void fill_depth(cv::Mat& depth);

/// Inverse depth in colours (near red, far blue, none black) with a bar that says which colour is which depth.
cv::Mat depth_picture(const cv::Mat& depth);

/// Binary PLY of the points of camera 0, metres, with the colours of `image`.
std::string cloud_ply(const cv::Mat& depth, const cv::Mat& image, const Camera& camera);

/// Raw units a metre of the 16-bit PNG: a power of ten that holds the largest depth.
double png_scale(const cv::Mat& depth);

/// Writes depth.tiff, depth.exr where OpenCV can, depth.png, confidence.png, colour.png and cloud.ply. Returns their names.
std::string write_depth(const std::string& folder, const DepthMap& map, const cv::Mat& image, const Camera& camera);

}  // namespace iclk
