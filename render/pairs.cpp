#include <iclk/render/pairs.h>

#include <algorithm>
#include <cmath>
#include <random>

#include <Eigen/Geometry>

#include <iclk/align/common/text.h>
#include <iclk/engine/error.h>

namespace iclk {
namespace {

using Eigen::AngleAxisd;
using Eigen::Vector3d;
using internal::text_of;

constexpr int kDraws = 5000;
// Pixels per side of the small views that reject most unsuitable poses.
constexpr int kQuick = 24;

[[noreturn]] void fail(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

}  // namespace

/// The standard distributions differ between libraries; this does not.
class PairSource::Random {
 public:
  Random(uint64_t seed, uint64_t index) {
    std::seed_seq mix{static_cast<uint32_t>(seed), static_cast<uint32_t>(seed >> 32), static_cast<uint32_t>(index),
                      static_cast<uint32_t>(index >> 32)};
    engine_.seed(mix);
  }
  double between(double a, double b) { return a + (b - a) * (static_cast<double>(engine_() >> 11) * 0x1p-53); }

 private:
  std::mt19937_64 engine_;
};

namespace {

/// A camera with kQuick x kQuick of the pixel centres of the other, including the outermost ones.
Camera quick_camera(const Camera& camera) {
  const double x = (kQuick - 1.0) / (camera.width - 1), y = (kQuick - 1.0) / (camera.height - 1);
  return {camera.fx * x, camera.fy * y, camera.cx * x, camera.cy * y, kQuick, kQuick};
}

/// A level camera at C that looks at a point `ahead` m away in the direction of `azimuth` and `below` m below.
SE3 level_camera(const Vector3d& C, double azimuth, double ahead, double below) {
  SE3 T_WC;
  const Vector3d forward(std::sin(azimuth), std::cos(azimuth), 0);
  T_WC.R.col(0) = Vector3d(forward.y(), -forward.x(), 0);
  T_WC.R.col(2) = (ahead * forward - below * Vector3d::UnitZ()).normalized();
  T_WC.R.col(1) = T_WC.R.col(2).cross(T_WC.R.col(0));
  T_WC.t = C;
  return T_WC;
}

/// (x, y) of the ray through every pixel. NaN where there is none, and at the very edge of the lens's domain, where the single
/// precision of the device may differ.
std::vector<Eigen::Vector2d> rays_of(const Camera& camera, const Lens& lens) {
  std::vector<Eigen::Vector2d> rays;
  for (int v = 0; v < camera.height; ++v)
    for (int u = 0; u < camera.width; ++u) {
      const auto ray = lens.undistort(camera.ray({u, v}).head<2>());
      rays.push_back(ray && ray->norm() < 0.995 * lens.radius() ? *ray : Eigen::Vector2d(NAN, NAN));
    }
  return rays;
}

/// The mean distance between the positions in both views of the ground that camera 0 sees, px of the undistorted image.
double mean_motion(const View& view, const std::vector<Eigen::Vector2d>& rays, const Camera& full, const SE3& T_10) {
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < rays.size(); ++i) {
    if (std::isnan(rays[i].x())) continue;
    const Vector3d X0 = static_cast<double>(view.depth[i]) * rays[i].homogeneous(), X1 = T_10 * X0;
    if (!(X1.z() > 0)) return INFINITY;
    sum += (full.project(X1) - full.project(X0)).norm();
    ++count;
  }
  return sum / std::max(count, 1);
}

}  // namespace

void PairOptions::check() const {
  for (const Camera& c : {camera, second ? second->camera : camera}) {
    c.check();
    if (c.width < 2 || c.height < 2)
      fail("a camera of " + std::to_string(c.width) + "x" + std::to_string(c.height) + " pixels is too small");
  }
  if (!(altitude_min > 0) || !(altitude_max >= altitude_min) || !std::isfinite(altitude_max))
    fail("altitudes of " + text_of(altitude_min) + " to " + text_of(altitude_max) +
         " m must be positive and in ascending order");
  if (!(tilt >= 0) || !(tilt < 1.5)) fail("a tilt of " + text_of(tilt * 180 / M_PI) + " degrees must be 0 to 85");
  if (!(translation >= 0) || !std::isfinite(translation))
    fail("a perturbation of " + text_of(translation) + " m must not be negative");
  if (!(rotation >= 0) || !(rotation <= 1.5)) fail("a perturbation of " + text_of(rotation) + " rad must be 0 to 1.5");
  if (!(orbit_min >= 0) || !(orbit_max >= orbit_min) || !(orbit_max <= M_PI))
    fail("an orbit of " + text_of(orbit_min * 180 / M_PI) + " to " + text_of(orbit_max * 180 / M_PI) +
         " degrees must be 0 to 180, in ascending order");
  if (!(start_min >= 0) || !(start_max > start_min))
    fail("a start of " + text_of(start_min) + " to " + text_of(start_max) + " px must not be negative and in ascending order");
  if (!(nearest >= 0) || !(nearest < 1)) fail("nearest " + text_of(nearest) + " (a share of the altitude) must be 0 to 1");
  if (region.empty() || !(region.left >= 0 && region.bottom >= 0 && region.right <= 1 && region.top <= 1))
    fail("region " + text_of(region.left) + "," + text_of(region.bottom) + "," + text_of(region.right) + "," +
         text_of(region.top) + ": x0,y0,x1,y1 are fractions of the map, 0 <= x0 < x1 <= 1 and 0 <= y0 < y1 <= 1");
}

std::string PairSource::Rejected::text() const {
  return std::to_string(draws) + " poses drawn; rejected: " + std::to_string(outside) +
         " because a view left the region or met missing data, " + std::to_string(too_near) +
         " because the ground was too near" + (start > 0 ? ", " + std::to_string(start) + " because of --start" : "");
}

PairSource::Eye::Eye(const Camera& c, const Lens& l)
    : camera(c), quick(quick_camera(c)), lens(l), rays(rays_of(c, l)), quick_rays(rays_of(quick, l)) {}

PairSource::PairSource(TerrainRenderer& renderer, const PairOptions& options, TerrainRenderer* target)
    : renderer_(renderer), target_(target ? *target : renderer), options_(options) {
  options_.check();
  const MapBox map = renderer.terrain().extent();
  region_ = {map.left + options_.region.left * map.width(), map.bottom + options_.region.bottom * map.height(),
             map.left + options_.region.right * map.width(), map.bottom + options_.region.top * map.height()};
  eyes_.emplace_back(options_.camera, options_.lens);
  if (options_.second) eyes_.emplace_back(options_.second->camera, options_.second->lens);
}

bool PairSource::acceptable(const View& view, const std::vector<Eigen::Vector2d>& rays, const SE3& T_WC, double nearest) {
  for (size_t i = 0; i < rays.size(); ++i) {
    if (std::isnan(rays[i].x())) continue;
    const double z = view.depth[i];
    const Vector3d X = T_WC * (z * rays[i].homogeneous());
    if (!(z > 0) || !region_.contains(X.x(), X.y())) return ++rejected_.outside, false;
    if (z < nearest) return ++rejected_.too_near, false;
  }
  return true;
}

bool PairSource::draw_perturbed(Random& random, RenderedPair& pair) const {
  const double x = random.between(region_.left, region_.right), y = random.between(region_.bottom, region_.top);
  pair.altitude = random.between(options_.altitude_min, options_.altitude_max);
  const double heading = random.between(0, 2 * M_PI), tilt = random.between(0, options_.tilt),
               roll = random.between(0, 2 * M_PI);
  SE3 T_01;
  if (options_.second) {
    T_01 = options_.second->T_10.inverse();
  } else {
    Vector6d turn = Vector6d::Zero();
    for (double& r : T_01.t) r = random.between(-options_.translation, options_.translation);
    for (double& r : turn.tail<3>()) r = random.between(-options_.rotation, options_.rotation);
    T_01.R = SE3::exp(turn).R;
  }

  const auto ground = renderer_.terrain().height_at(x, y);
  if (!ground) return false;
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  pair.T_W0.t = {x, y, *ground + pair.altitude};
  pair.T_W0.R = AngleAxisd(heading, Vector3d::UnitZ()).toRotationMatrix() * down *
                AngleAxisd(tilt, Vector3d::UnitX()).toRotationMatrix() * AngleAxisd(roll, Vector3d::UnitZ()).toRotationMatrix();
  pair.T_W1 = pair.T_W0 * T_01;
  pair.T_10 = T_01.inverse();
  return true;
}

bool PairSource::draw_orbit(Random& random, RenderedPair& pair) const {
  const double x = random.between(region_.left, region_.right), y = random.between(region_.bottom, region_.top);
  pair.altitude = random.between(options_.altitude_min, options_.altitude_max);
  const double azimuth = random.between(0, 2 * M_PI), radius = pair.altitude * std::tan(random.between(0, options_.tilt));
  const double side = random.between(-1, 1) < 0 ? -1 : 1,
               azimuth1 = azimuth + side * random.between(options_.orbit_min, options_.orbit_max);
  const double altitude1 = pair.altitude * std::exp(random.between(-std::log(1.25), std::log(1.25)));
  Vector6d turn = Vector6d::Zero();
  for (double& r : turn.tail<3>()) r = random.between(-options_.rotation, options_.rotation);

  const auto ground = renderer_.terrain().height_at(x, y);
  if (!ground) return false;
  const auto camera = [&](double towards, double altitude) {
    const Vector3d C(x - radius * std::sin(towards), y - radius * std::cos(towards), *ground + altitude);
    return level_camera(C, towards, radius, altitude);
  };
  pair.T_W0 = camera(azimuth, pair.altitude);
  pair.T_W1 = camera(azimuth1, altitude1) * SE3::exp(turn);
  pair.T_10 = pair.T_W1.inverse() * pair.T_W0;
  return true;
}

RenderedPair PairSource::draw(uint64_t index) {
  Random random(options_.seed, index);
  const Rejected before = rejected_;
  for (int draw = 0; draw < kDraws; ++draw) {
    ++rejected_.draws;
    RenderedPair pair;
    if (!(options_.orbit_max > 0 && !options_.second ? draw_orbit(random, pair) : draw_perturbed(random, pair))) {
      ++rejected_.outside;
      continue;
    }
    const double nearest = options_.nearest * pair.altitude;
    const auto hits_ground = [&](const SE3& T_WC) {
      const auto ground = renderer_.terrain().height_at(T_WC.t.x(), T_WC.t.y());
      return ground && T_WC.t.z() - *ground < nearest;
    };
    if (hits_ground(pair.T_W0) || hits_ground(pair.T_W1)) {
      ++rejected_.too_near;
      continue;
    }
    const Eye &eye0 = eyes_.front(), &eye1 = eyes_.back();
    View quick;
    const auto glimpses = [&](const Eye& eye, const SE3& T_WC) {
      quick = renderer_.render(eye.quick, T_WC, eye.lens);
      return acceptable(quick, eye.quick_rays, T_WC, nearest);
    };
    const auto sees = [&](TerrainRenderer& renderer, const Eye& eye, const SE3& T_WC, View& view) {
      view = renderer.render(eye.camera, T_WC, eye.lens);
      return acceptable(view, eye.rays, T_WC, nearest);
    };
    if (!glimpses(eye0, pair.T_W0)) continue;
    const double start = mean_motion(quick, eye0.quick_rays, options_.camera, pair.T_10);
    if (start < options_.start_min || start > options_.start_max) {
      ++rejected_.start;
      continue;
    }
    if (!glimpses(eye1, pair.T_W1)) continue;
    if (!sees(renderer_, eye0, pair.T_W0, pair.view0) || !sees(target_, eye1, pair.T_W1, pair.view1)) continue;
    return pair;
  }
  const Camera& c = options_.camera;
  const double wide = options_.altitude_min * c.width / std::abs(c.fx),
               high = options_.altitude_min * c.height / std::abs(c.fy);
  Rejected now = rejected_;
  now.draws -= before.draws, now.outside -= before.outside, now.too_near -= before.too_near, now.start -= before.start;
  fail("no room for a pair: from " + text_of(options_.altitude_min) + " m a view covers " + text_of(std::round(wide)) + " x " +
       text_of(std::round(high)) + " m of level ground, but the region is " + text_of(std::round(region_.width())) + " x " +
       text_of(std::round(region_.height())) + " m (" + now.text() +
       "); take lower altitudes, less tilt, a longer focal length, a larger region" +
       (now.start > 0 ? " or another --start" : ""));
}

}  // namespace iclk
