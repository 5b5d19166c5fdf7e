#include "apps/eval/locate/defects.h"

#include <cmath>

#include <opencv2/imgproc.hpp>

#include "apps/eval/appearance_draw.h"
#include "apps/iclk/common/angles.h"
#include "apps/iclk/sets/render_options.h"

namespace iclk {
namespace {

constexpr double kWindow = 26;    // m: what is narrower and stands out of the ground is an object
constexpr double kStandOut = 2;   // m
constexpr double kLargest = 400;  // m2, of objects that a map lacks
constexpr int kSeasons = 5;       // snow is the last

cv::Mat heights_of(const Terrain& terrain) {
  return cv::Mat(terrain.relief.height, terrain.relief.width, CV_32FC1, const_cast<float*>(terrain.height.data())).clone();
}

/// RGB in [0, 1].
cv::Mat colours_of(const Terrain& terrain) {
  const cv::Mat rgba(terrain.mosaic.height, terrain.mosaic.width, CV_8UC4, const_cast<uint32_t*>(terrain.rgba.data()));
  cv::Mat rgb, colours;
  cv::cvtColor(rgba, rgb, cv::COLOR_RGBA2RGB);
  rgb.convertTo(colours, CV_32FC3, 1.0 / 255);
  return colours;
}

/// The grid of the same box with steps of about `step`.
Grid coarser(const Grid& grid, double step) {
  Grid out = grid;
  if (step <= 0) return out;
  out.width = std::max(2, static_cast<int>(std::lround(grid.width * grid.step_x / step)));
  out.height = std::max(2, static_cast<int>(std::lround(grid.height * grid.step_y / step)));
  out.step_x = grid.width * grid.step_x / out.width, out.step_y = grid.height * grid.step_y / out.height;
  return out;
}

/// Standard normal, smooth over `cell` pixels.
cv::Mat smooth_noise(cv::Size size, double cell, cv::RNG& random) {
  cv::Mat noise(std::max(2, static_cast<int>(size.height / cell)) + 1, std::max(2, static_cast<int>(size.width / cell)) + 1,
                CV_32FC1);
  random.fill(noise, cv::RNG::NORMAL, 0, 1);
  cv::resize(noise, noise, size, 0, 0, cv::INTER_CUBIC);
  return noise;
}

/// Lowers a share of the houses and trees to the ground around them.
void remove_objects(cv::Mat& heights, double step, double share, cv::RNG& random) {
  const int window = static_cast<int>(kWindow / step) | 1;
  cv::Mat ground, labels, sizes, centres;
  cv::morphologyEx(heights, ground, cv::MORPH_OPEN, cv::getStructuringElement(cv::MORPH_ELLIPSE, {window, window}));
  const cv::Mat objects = heights - ground > kStandOut;
  std::vector<uchar> gone(static_cast<size_t>(cv::connectedComponentsWithStats(objects, labels, sizes, centres)));
  for (size_t i = 1; i < gone.size(); ++i)
    gone[i] = random.uniform(0.0, 1.0) < share && sizes.at<int>(static_cast<int>(i), cv::CC_STAT_AREA) * step * step < kLargest;
  cv::Mat lowered(heights.size(), CV_8UC1);
  for (int v = 0; v < heights.rows; ++v)
    for (int u = 0; u < heights.cols; ++u) lowered.at<uchar>(v, u) = gone[static_cast<size_t>(labels.at<int>(v, u))];
  cv::dilate(lowered, lowered, cv::Mat(), {-1, -1}, std::max(1, static_cast<int>(1 / step)));
  ground.copyTo(heights, lowered);
}

/// The share of light on each height: shading, and what stands between it and the sun.
cv::Mat light_on(const cv::Mat& heights, double step, const Eigen::Vector3d& sun, bool cast) {
  cv::Mat light(heights.size(), CV_32FC1);
  const Eigen::Vector2d along = sun.head<2>().normalized();
  const double rise = step * sun.z() / sun.head<2>().norm();
  const auto at = [&](int v, int u) {
    return heights.at<float>(std::clamp(v, 0, heights.rows - 1), std::clamp(u, 0, heights.cols - 1));
  };
  for (int v = 0; v < heights.rows; ++v)
    for (int u = 0; u < heights.cols; ++u) {
      const Eigen::Vector3d normal((at(v, u - 1) - at(v, u + 1)) / (2 * step), (at(v + 1, u) - at(v - 1, u)) / (2 * step), 1);
      double l = std::clamp(0.35 + 0.85 * normal.normalized().dot(sun), 0.15, 1.3);
      for (int i = 1; cast && i * rise < 20; ++i)
        if (at(v - static_cast<int>(std::lround(i * along.y())), u + static_cast<int>(std::lround(i * along.x()))) >
            at(v, u) + i * rise + 0.3) {
          l *= 0.55;
          break;
        }
      light.at<float>(v, u) = static_cast<float>(l);
    }
  return light;
}

Eigen::Vector3d towards(double azimuth, double elevation) {
  return {std::cos(elevation) * std::sin(azimuth), std::cos(elevation) * std::cos(azimuth), std::sin(elevation)};
}

/// The values of a map's raster at the pixels of another grid.
cv::Mat on_grid(const cv::Mat& values, const Grid& from, const Grid& to) {
  const Eigen::Vector2d first = from.pixel(to.left + 0.5 * to.step_x, to.top - 0.5 * to.step_y);
  const double sx = to.step_x / from.step_x, sy = to.step_y / from.step_y;
  const cv::Matx23d map(sx, 0, first.x(), 0, sy, first.y());
  cv::Mat out;
  cv::warpAffine(values, out, map, {to.width, to.height}, cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);
  return out;
}

void multiply(cv::Mat& colours, const cv::Mat& factor) {
  cv::Mat three;
  cv::merge(std::vector<cv::Mat>(3, factor), three);
  colours = colours.mul(three);
}

void relight(cv::Mat& colours, const Grid& mosaic, const Terrain& ground, const MapDefects& d) {
  const cv::Mat heights = heights_of(ground);
  const cv::Mat before = light_on(heights, ground.relief.step_x, Eigen::Vector3d(-0.5, 0.45, 0.74).normalized(), false);
  cv::Mat ratio = light_on(heights, ground.relief.step_x, towards(d.azimuth, d.elevation), true) / before;
  cv::pow(ratio, d.light, ratio);
  multiply(colours, on_grid(ratio, ground.relief, mosaic));
}

void park_cars(cv::Mat& colours, const Grid& mosaic, int per_hectare, cv::RNG& random) {
  const double hectares = mosaic.box().width() * mosaic.box().height() / 1e4;
  for (int i = 0; i < per_hectare * hectares; ++i) {
    const cv::RotatedRect car({random.uniform(0.f, 1.f) * static_cast<float>(mosaic.width),
                               random.uniform(0.f, 1.f) * static_cast<float>(mosaic.height)},
                              {static_cast<float>(4.5 / mosaic.step_x), static_cast<float>(1.9 / mosaic.step_x)},
                              random.uniform(0.f, 360.f));
    cv::Point2f corners[4];
    car.points(corners);
    std::vector<cv::Point> outline;
    for (const cv::Point2f& corner : corners) outline.emplace_back(cvRound(16 * corner.x), cvRound(16 * corner.y));
    const double grey = random.uniform(0.05, 1.0);
    cv::fillConvexPoly(colours, outline, cv::Scalar::all(grey), cv::LINE_8, 4);
  }
}

/// Blocks of other exposure, each a little off its place.
void cut_blocks(cv::Mat& colours, const Grid& mosaic, const MapDefects& d, cv::RNG& random) {
  const int side = std::max(2, static_cast<int>(d.block / mosaic.step_x));
  cv::Mat u(colours.size(), CV_32FC1), v(colours.size(), CV_32FC1), gain(colours.size(), CV_32FC3);
  for (int top = -random.uniform(0, side); top < colours.rows; top += side)
    for (int left = -random.uniform(0, side); left < colours.cols; left += side) {
      const cv::Rect block = cv::Rect(left, top, side, side) & cv::Rect({}, colours.size());
      const double du = random.gaussian(d.block_shift), dv = random.gaussian(d.block_shift);
      gain(block) =
          cv::Scalar(1 + random.gaussian(d.block_gain), 1 + random.gaussian(d.block_gain), 1 + random.gaussian(d.block_gain));
      for (int y = block.y; y < block.y + block.height; ++y)
        for (int x = block.x; x < block.x + block.width; ++x)
          u.at<float>(y, x) = static_cast<float>(x + du), v.at<float>(y, x) = static_cast<float>(y + dv);
    }
  cv::Mat moved;
  cv::remap(colours, moved, u, v, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  colours = moved.mul(gain);
}

void add_cloud(cv::Mat& colours, const Grid& mosaic, double radius, cv::RNG& random) {
  const double u = mosaic.width * random.uniform(0.35, 0.65), v = mosaic.height * random.uniform(0.35, 0.65);
  const double r = radius / mosaic.step_x;
  const cv::Mat edge = smooth_noise(colours.size(), 0.4 * r, random);
  for (int y = 0; y < colours.rows; ++y)
    for (int x = 0; x < colours.cols; ++x) {
      const double out = std::hypot(x - u, y - v) / r + 0.25 * edge.at<float>(y, x);
      const auto white = static_cast<float>(0.95 * std::clamp(2.5 * (1 - out), 0.0, 1.0));
      cv::Vec3f& c = colours.at<cv::Vec3f>(y, x);
      c += white * (cv::Vec3f(0.93f, 0.94f, 0.96f) - c);
    }
}

void set_heights(Terrain& map, const Terrain& ground, const MapDefects& d, cv::RNG& random) {
  cv::Mat heights = heights_of(ground);
  if (d.missing > 0) remove_objects(heights, ground.relief.step_x, d.missing, random);
  map.relief = coarser(ground.relief, d.spacing);
  if (d.spacing > 0) {
    cv::GaussianBlur(heights, heights, {}, 0.5 * d.spacing / ground.relief.step_x);
    cv::resize(heights, heights, {map.relief.width, map.relief.height}, 0, 0, cv::INTER_AREA);
  }
  if (d.height_noise > 0) heights += d.height_noise * smooth_noise(heights.size(), 3, random);
  map.height.assign(heights.begin<float>(), heights.end<float>());
}

/// A day of the season, with the sun up to `reach` degrees from south, where it stands highest. Its text is exact.
Date draw_date(Season season, int reach, Random& random) {
  Date date = Date::of(season, static_cast<uint64_t>(random.below(1000)));
  const int from_south = random.below(2 * reach + 1) - reach;
  date.sun_azimuth = (180 + from_south) * kDegree;
  date.sun_elevation = std::round(std::cos(from_south * kDegree / 1.5) * date.sun_elevation / kDegree) * kDegree;
  return date;
}

}  // namespace

MapDefects draw_defects(uint64_t seed, double pixel) {
  Random random(seed);
  MapDefects d;
  d.seed = random.word();
  d.texel = pixel * 2 * std::pow(3, random.uniform());
  d.spacing = random.uniform(1, 4);
  d.height_noise = random.uniform(0.1, 0.5);
  d.missing = random.uniform(0, 0.4);
  d.block = random.uniform(60, 150);
  d.block_gain = random.uniform(0.02, 0.12);
  d.block_shift = random.uniform(0, 0.5);
  d.light = random.uniform(0, 0.7);
  d.azimuth = random.uniform(0, 2 * M_PI);
  d.elevation = random.uniform(0.6, 1.1);
  d.cars = random.below(15);
  d.cloud = random.uniform() < 0.5 ? random.uniform(15, 45) : 0;
  return d;
}

MapDefects draw_season(uint64_t seed, double pixel) {
  MapDefects d = draw_defects(seed, pixel);
  Random random(counter_word(seed, 1000));
  const int map = random.below(kSeasons - 1), frames = (map + 1 + random.below(kSeasons - 1)) % kSeasons;
  d.dates = {draw_date(static_cast<Season>(frames), 80, random), draw_date(static_cast<Season>(map), 30, random)};
  d.light = 0;  // the date has its own sun
  return d;
}

Terrain degraded(const Terrain& ground, const MapDefects& d) {
  cv::RNG random(d.seed);
  Terrain map;
  set_heights(map, ground, d, random);
  map.mosaic = coarser(ground.mosaic, d.texel);
  cv::Mat colours = colours_of(ground), rgba;
  if (d.cars > 0) park_cars(colours, ground.mosaic, d.cars, random);
  cv::resize(colours, colours, {map.mosaic.width, map.mosaic.height}, 0, 0, cv::INTER_AREA);
  if (d.light > 0) relight(colours, map.mosaic, ground, d);
  if (d.block > 0) cut_blocks(colours, map.mosaic, d, random);
  if (d.cloud > 0) add_cloud(colours, map.mosaic, d.cloud, random);
  colours.convertTo(rgba, CV_8UC3, 255);
  cv::cvtColor(rgba, rgba, cv::COLOR_RGB2RGBA);
  const auto* pixels = reinterpret_cast<const uint32_t*>(rgba.data);
  map.rgba.assign(pixels, pixels + rgba.total());
  return map;
}

nlohmann::ordered_json to_json(const MapDefects& d) {
  nlohmann::ordered_json json = {
      {"seed", d.seed},       {"texel", d.texel},     {"spacing", d.spacing},       {"height_noise", d.height_noise},
      {"missing", d.missing}, {"block", d.block},     {"block_gain", d.block_gain}, {"block_shift", d.block_shift},
      {"light", d.light},     {"azimuth", d.azimuth}, {"elevation", d.elevation},   {"cars", d.cars},
      {"cloud", d.cloud}};
  if (d.dates) json["dates"] = {{"frames", to_text(d.dates->frames)}, {"map", to_text(d.dates->map)}};
  return json;
}

}  // namespace iclk
