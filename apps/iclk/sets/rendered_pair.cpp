#include "apps/iclk/sets/rendered_pair.h"

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>

namespace iclk {
namespace {

/// As a camera with this exposure and noise would have it.
cv::Mat photograph(const View& view, double gain, double bias, double sigma, uint64_t seed) {
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  cv::Mat bgr, exposed, noise(view.height, view.width, CV_32FC3), out;
  cv::cvtColor(rgba, bgr, cv::COLOR_RGBA2BGR);
  bgr.convertTo(exposed, CV_32FC3, gain, bias);
  cv::RNG(seed).fill(noise, cv::RNG::NORMAL, 0, sigma);
  cv::Mat(exposed + noise).convertTo(out, CV_8UC3);
  return out;
}

cv::Mat depth_of(const View& view) {
  return cv::Mat(view.height, view.width, CV_32FC1, const_cast<float*>(view.depth.data())).clone();
}

}  // namespace

ScenePair render_scene_pair(const std::shared_ptr<const engine::Context>& context, const SceneOptions& options) {
  TerrainRenderer renderer(context, std::make_shared<const Terrain>(procedural_terrain({.seed = 1, .size = 512})));
  ScenePair pair;
  const double f = 0.82 * options.width;
  pair.camera = {f, f, 0.5 * (options.width - 1), 0.5 * (options.height - 1), options.width, options.height};
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  const double x = 308, y = 325;  // a village
  const SE3 T_W0{down * Eigen::AngleAxisd(0.15, Eigen::Vector3d::UnitX()).toRotationMatrix(),
                 {x, y, renderer.terrain().height_at(x, y).value_or(0) + 120}};
  Vector6d xi;
  xi << 2.4, -1.7, 2.1, 0.020, 0.028, -0.040;
  pair.T_10 = SE3::exp(xi);
  const View view0 = renderer.render(pair.camera, T_W0), view1 = renderer.render(pair.camera, T_W0 * pair.T_10.inverse());
  pair.image_0 = photograph(view0, 1, 0, options.noise, 2 * options.seed);
  pair.image_1 = photograph(view1, options.gain, options.bias, options.noise, 2 * options.seed + 1);
  pair.depth_0 = depth_of(view0), pair.depth_1 = depth_of(view1);
  return pair;
}

}  // namespace iclk
