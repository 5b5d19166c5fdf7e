#include "apps/iclk/sets/scene.h"

#include <algorithm>
#include <cmath>

#include <opencv2/core/utility.hpp>

#include <iclk/render/internal/noise.h>

namespace iclk {
namespace {

constexpr double kGround = 2.0;    // m from camera 0
constexpr double kHighest = 0.45;  // m above ground, a bound
constexpr double kLowest = -0.05;

using internal::noise;
using internal::unit;

/// Noise of several scales, about in [0, 1].
double turbulence(double x, double y, double cell, int octaves, uint32_t salt) {
  double sum = 0, weight = 1, total = 0;
  for (int i = 0; i < octaves; ++i, cell *= 0.5, weight *= 0.55) {
    sum += weight * noise(x / cell, y / cell, salt + static_cast<uint32_t>(i));
    total += weight;
  }
  return sum / total;
}

/// Height above ground, m. Slopes stay below 1, so that a ray from above meets the surface once.
double height(double x, double y) {
  const auto hill = [&](double cx, double cy, double radius, double top) {
    return top * std::exp(-((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (radius * radius));
  };
  return 0.03 + hill(-0.45, -0.25, 0.38, 0.26) + hill(0.50, 0.28, 0.42, 0.22) + hill(0.55, -0.45, 0.25, 0.13) +
         hill(-0.5, 0.5, 0.22, 0.1) + 0.05 * turbulence(x + 7, y + 3, 0.35, 3, 11);
}

Eigen::Vector3d normal(double x, double y) {
  constexpr double d = 2e-3;
  return Eigen::Vector3d((height(x + d, y) - height(x - d, y)) / (2 * d), (height(x, y + d) - height(x, y - d)) / (2 * d), 1)
      .normalized();
}

/// BGR in [0, 255]: meadows, woods, rock and snow by height and steepness, fields with hedges, a road, light from the upper
/// left.
Eigen::Vector3d colour(double x, double y) {
  const double h = height(x, y) + 0.07 * (turbulence(x, y, 0.2, 4, 31) - 0.5);
  const Eigen::Vector3d n = normal(x, y);
  const auto mix = [](const Eigen::Vector3d& a, const Eigen::Vector3d& b, double t) {
    t = std::clamp(t, 0.0, 1.0);
    return Eigen::Vector3d((1 - t) * a + t * b);
  };
  const Eigen::Vector3d meadow(60, 150, 110), wood(40, 80, 45), field(95, 190, 215), rock(120, 128, 140), snow(250, 245, 240),
      road(175, 180, 185);
  Eigen::Vector3d c = mix(meadow, wood, 6 * (turbulence(x + 3, y, 0.3, 3, 51) - 0.45));
  // Fields: cells of a crooked grid, each of its own brightness, in the lowlands.
  const double wx = x + 0.05 * noise(x * 5, y * 5, 61), wy = y + 0.05 * noise(x * 5, y * 5, 62);
  const double field_x = wx / 0.16, field_y = wy / 0.12;
  const int ix = static_cast<int>(std::floor(field_x)), iy = static_cast<int>(std::floor(field_y));
  const double edge = std::min({field_x - ix, 1 - (field_x - ix), field_y - iy, 1 - (field_y - iy)});
  if (h < 0.13 && unit(ix, iy, 71) < 0.6) {
    c = mix(c, field * (0.55 + 0.6 * unit(ix, iy, 72)), 0.85);
    if (edge < 0.06) c = 0.5 * wood;
  }
  c = mix(c, rock, (h - 0.17) / 0.03);
  c = mix(c, snow, (h - 0.25) / 0.02);
  // A road that winds through the valley.
  const double off = std::abs(y - 0.06 - 0.22 * std::sin(2.1 * x + 0.4));
  if (off < 0.022) c = off > 0.017 ? Eigen::Vector3d(70, 75, 80) : road;
  const double grain = 0.55 + 0.9 * turbulence(x, y, 0.045, 3, 81);
  const double light = std::clamp(0.35 + 0.75 * n.dot(Eigen::Vector3d(-0.55, -0.45, 0.7).normalized()), 0.0, 1.3);
  return (c * grain * light).cwiseMin(255.0).cwiseMax(0.0);
}

/// Where the ray from `o` (world = camera 0) along `d` meets the surface z = kGround - height; returns the ray parameter.
double cast(const Eigen::Vector3d& o, const Eigen::Vector3d& d) {
  const auto above = [&](double s) { return kGround - height(o.x() + s * d.x(), o.y() + s * d.y()) - (o.z() + s * d.z()); };
  double low = (kGround - kHighest - o.z()) / d.z(), high = (kGround - kLowest - o.z()) / d.z();
  double f_low = above(low), f_high = above(high);
  // Illinois variant of regula falsi: the bracket holds one crossing.
  for (int i = 0, side = 0; i < 60 && std::abs(high - low) > 1e-12; ++i) {
    const double s = (f_low * high - f_high * low) / (f_low - f_high), f = above(s);
    if (std::abs(f) < 1e-10) return s;
    if (f > 0) {
      low = s, f_low = f;
      if (side == 1) f_high *= 0.5;
      side = 1;
    } else {
      high = s, f_high = f;
      if (side == -1) f_low *= 0.5;
      side = -1;
    }
  }
  return 0.5 * (low + high);
}

cv::Mat render(const Camera& camera, const SE3& T_cw, double gain, double bias, double sigma, uint64_t seed) {
  const SE3 T_wc = T_cw.inverse();
  cv::Mat image(camera.height, camera.width, CV_8UC3);
  cv::parallel_for_({0, camera.height}, [&](const cv::Range& rows) {
    for (int v = rows.start; v < rows.end; ++v) {
      cv::RNG random(seed * 1000003u + static_cast<uint64_t>(v) + 1);
      for (int u = 0; u < camera.width; ++u) {
        Eigen::Vector3d sum = Eigen::Vector3d::Zero();
        for (int sample = 0; sample < 4; ++sample) {  // the mean over a pixel's area
          const Eigen::Vector2d uv(u + ((sample & 1) - 0.5) * 0.5, v + ((sample >> 1) - 0.5) * 0.5);
          const Eigen::Vector3d d = T_wc.R * camera.ray(uv), X = T_wc.t + cast(T_wc.t, d) * d;
          sum += colour(X.x(), X.y());
        }
        for (int c = 0; c < 3; ++c)
          image.at<cv::Vec3b>(v, u)[c] = cv::saturate_cast<uchar>(gain * sum[c] / 4 + bias + random.gaussian(sigma));
      }
    }
  });
  return image;
}

cv::Mat render_depth(const Camera& camera, const SE3& T_cw) {
  const SE3 T_wc = T_cw.inverse();
  cv::Mat depth(camera.height, camera.width, CV_32FC1);
  cv::parallel_for_({0, camera.height}, [&](const cv::Range& rows) {
    for (int v = rows.start; v < rows.end; ++v)
      for (int u = 0; u < camera.width; ++u) {
        // The ray's third component is 1 in the camera: the parameter is the depth.
        depth.at<float>(v, u) = static_cast<float>(cast(T_wc.t, T_wc.R * camera.ray({u, v})));
      }
  });
  return depth;
}

}  // namespace

SE3 demo_motion() {
  Vector6d xi;
  xi << 0.045, -0.03, 0.035, 0.020, 0.028, -0.040;
  return SE3::exp(xi);
}

ScenePair make_scene_pair(const SE3& T_10, const SceneOptions& options) {
  ScenePair pair;
  const double f = 0.82 * options.width;
  pair.camera = {f, f, 0.5 * options.width - 0.5, 0.5 * options.height - 0.5, options.width, options.height};
  pair.T_10 = T_10;
  pair.image_0 = render(pair.camera, SE3(), 1, 0, options.noise, 2 * options.seed);
  pair.image_1 = render(pair.camera, T_10, options.gain, options.bias, options.noise, 2 * options.seed + 1);
  pair.depth_0 = render_depth(pair.camera, SE3());
  pair.depth_1 = render_depth(pair.camera, T_10);
  return pair;
}

}  // namespace iclk
