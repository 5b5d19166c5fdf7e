#include "apps/iclk/depth/output.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/pictures/drawing.h"

namespace iclk {
namespace {

std::string encoded(const char* ending, const cv::Mat& image) {
  std::vector<uchar> bytes;
  if (!cv::imencode(ending, image, bytes)) throw Error(ErrorCode::io, "OpenCV cannot encode " + std::string(ending));
  return {bytes.begin(), bytes.end()};
}

}  // namespace

cv::Mat depth_image(const DepthMap& map) {
  cv::Mat depth(map.inverse_depth.height, map.inverse_depth.width, CV_32FC1, cv::Scalar(0));
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const float w = map.inverse_depth.at(u, v);
      if (w > 0) depth.at<float>(v, u) = 1 / w;
    }
  return depth;
}

void fill_depth(cv::Mat& depth) {
  DepthMap map{Map(depth.cols, depth.rows), Map(depth.cols, depth.rows)};
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u)
      if (const float z = depth.at<float>(v, u); z > 0) map.inverse_depth.at(u, v) = 1 / z;
  fill(map);
  depth = depth_image(map);
}

cv::Mat depth_picture(const cv::Mat& depth) {
  std::vector<float> known;
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u)
      if (depth.at<float>(v, u) > 0) known.push_back(1 / depth.at<float>(v, u));
  std::sort(known.begin(), known.end());
  const float low = known.empty() ? 0 : known[known.size() / 100];
  const float high = std::max(known.empty() ? 1 : known[known.size() - 1 - known.size() / 100], low * 1.0001f + 1e-9f);
  const Pen pen(depth.cols);
  const int bar = pen.px(46);
  cv::Mat shade(depth.rows + bar, depth.cols, CV_8UC1, cv::Scalar(0)), colours;
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const float z = depth.at<float>(v, u);
      if (z > 0) shade.at<uchar>(v, u) = cv::saturate_cast<uchar>(255 * (1 / z - low) / (high - low));
    }
  for (int u = 0; u < depth.cols; ++u)
    shade(cv::Rect(u, depth.rows, 1, bar)) = cv::saturate_cast<uchar>(255.0 * u / (depth.cols - 1));
  cv::applyColorMap(shade, colours, cv::COLORMAP_TURBO);
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u)
      if (!(depth.at<float>(v, u) > 0)) colours.at<cv::Vec3b>(v, u) = {0, 0, 0};
  constexpr int kMarks = 5;
  for (int i = 0; i < kMarks; ++i) {
    const double share = 0.08 + 0.84 * i / (kMarks - 1);
    const double w = static_cast<double>(low) + share * static_cast<double>(high - low);
    const std::string words = w > 0 ? fmt::format("{:.3g} m", 1 / w) : "far";
    const int x = static_cast<int>(share * depth.cols) - pen.width(words) / 2;
    pen.text(colours, words, {x, depth.rows + bar * 2 / 3}, i == 0 || i == kMarks - 1 ? kInk : kPaper);
  }
  return colours;
}

std::string cloud_ply(const cv::Mat& depth, const cv::Mat& image, const Camera& camera) {
  const cv::Mat colours = colour_8bit(image);
  std::string points;
  size_t count = 0;
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const auto z = static_cast<double>(depth.at<float>(v, u));
      if (!(z > 0)) continue;
      const Eigen::Vector3f X = (camera.ray({u, v}) * z).cast<float>();
      const auto& bgr = colours.at<cv::Vec3b>(v, u);
      char bytes[15];
      std::memcpy(bytes, X.data(), 12);
      for (int i = 0; i < 3; ++i) bytes[12 + i] = static_cast<char>(bgr[2 - i]);
      points.append(bytes, sizeof bytes);
      ++count;
    }
  return fmt::format(
             "ply\nformat binary_little_endian 1.0\ncomment iclk depth\nelement vertex {}\nproperty float x\nproperty float y\n"
             "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
             count) +
         points;
}

double png_scale(const cv::Mat& depth) {
  double largest = 0;
  cv::minMaxLoc(depth, nullptr, &largest);
  double scale = 10000;
  while (scale * largest > 65535 && scale > 1e-9) scale /= 10;
  return scale;
}

std::string write_depth(const std::string& folder, const DepthMap& map, const cv::Mat& image, const Camera& camera) {
  const cv::Mat depth = depth_image(map);
  const auto put = [&](const char* name, const std::string& bytes) { write_file(folder + "/" + name, bytes); };
  std::string names = "depth.tiff, depth.png, confidence.png, colour.png, cloud.ply";
  put("depth.tiff", encoded(".tiff", depth));
  cv::Mat raw, confidence;
  depth.convertTo(raw, CV_16U, png_scale(depth));
  put("depth.png", encode_png(raw));
  cv::Mat(map.confidence.data, false).reshape(1, map.confidence.height).convertTo(confidence, CV_8U, 255);
  put("confidence.png", encode_png(confidence));
  put("colour.png", encode_png(depth_picture(depth)));
  put("cloud.ply", cloud_ply(depth, image, camera));
  try {
    put("depth.exr", encoded(".exr", depth));
    names += ", depth.exr";
  } catch (const cv::Exception&) {  // an OpenCV without OpenEXR
  }
  return names;
}

}  // namespace iclk
