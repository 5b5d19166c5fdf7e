#include "apps/eval/locate/run.h"

#include <cmath>
#include <filesystem>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/render/geotiff.h>
#include <iclk/render/procedural.h>
#include <iclk/session/device.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/output.h>

#include "apps/eval/appearance_draw.h"
#include "apps/eval/metrics.h"
#include "apps/eval/peers/methods.h"
#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/cpu_stopwatch.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/sets/pair_set.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

constexpr double kSize = 448;  // m, of procedural ground
constexpr double kLowest = 60, kHighest = 120, kTilt = 15 * kDegree;

struct Shot {
  SE3 T_WC;
  View view;
  cv::Mat image;  // as the camera has it
  SE3 prior;
};

Eigen::Vector3d unit_vector(Random& random) {
  const double z = random.uniform(-1, 1), a = random.uniform(0, 2 * M_PI), r = std::sqrt(1 - z * z);
  return {r * std::cos(a), r * std::sin(a), z};
}

Eigen::Matrix3d turn(double angle, const Eigen::Vector3d& axis) { return Eigen::AngleAxisd(angle, axis).toRotationMatrix(); }

cv::Mat bgr_of(const View& view) {
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  cv::Mat bgr;
  cv::cvtColor(rgba, bgr, cv::COLOR_RGBA2BGR);
  return bgr;
}

cv::Mat depth_of(const View& view) {
  return cv::Mat(view.height, view.width, CV_32FC1, const_cast<float*>(view.depth.data())).clone();
}

/// What another camera does to an image.
cv::Mat photograph(const cv::Mat& image, Random& random) {
  std::vector<Change> changes;
  for (const char* kind : {"vignetting:0.3", "exposure:0.15", "noise:0.15", "gamma:0.15", "jpeg:0.3"})
    for (const Change& change : draw_changes(parse_appearance(kind), random.word())) changes.push_back(change);
  return changed_image(image, changes);
}

SE3 disturbed(const SE3& truth, const LocateEvalOptions& o, Random& random) {
  SE3 prior = truth;
  prior.t += o.metres * unit_vector(random);
  prior.R = prior.R * turn(o.degrees * kDegree, unit_vector(random));
  if (o.elsewhere > 0) {
    const double a = random.uniform(0, 2 * M_PI);
    prior.t += o.elsewhere * Eigen::Vector3d(std::cos(a), std::sin(a), 0);
  }
  if (!o.heading) prior.R = turn(random.uniform(0, 2 * M_PI), Eigen::Vector3d::UnitZ()) * prior.R;
  return prior;
}

/// A view that sees nothing but ground, near the middle of the map.
Shot draw_shot(TerrainRenderer& ground, const LocateEvalOptions& o, Random& random) {
  const MapBox box = ground.terrain().extent();
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  for (int tries = 0; tries < 200; ++tries) {
    Shot shot;
    const double x = box.left + box.width() * random.uniform(0.36, 0.64),
                 y = box.bottom + box.height() * random.uniform(0.36, 0.64);
    const double altitude = random.uniform(kLowest, kHighest), heading = random.uniform(0, 2 * M_PI);
    const double about = random.uniform(0, 2 * M_PI), tilt = random.uniform(0, kTilt);
    const auto height = ground.terrain().height_at(x, y);
    if (!height) continue;
    shot.T_WC = {turn(heading, Eigen::Vector3d::UnitZ()) * down * turn(tilt, {std::cos(about), std::sin(about), 0}),
                 {x, y, *height + altitude}};
    shot.view = ground.render(o.camera, shot.T_WC);
    if (std::any_of(shot.view.depth.begin(), shot.view.depth.end(), [](float z) { return z <= 0; })) continue;
    shot.image = photograph(bgr_of(shot.view), random);
    shot.prior = disturbed(shot.T_WC, o, random);
    return shot;
  }
  refuse("the map, " + box.text() + ", is too small or has too many holes for a frame");
}

std::shared_ptr<const Terrain> make_ground(const LocateEvalOptions& o, int map, const std::optional<Date>& date) {
  if (!o.ortho.empty()) return std::make_shared<const Terrain>(GeoMap(o.ortho, o.elevation).whole());
  Random random(counter_word(o.seed, static_cast<uint64_t>(map)));
  ProceduralOptions ground;
  ground.seed = random.word();
  ground.size = kSize, ground.mosaic_step = 0.16, ground.relief_step = 0.5;
  ground.relief = random.uniform(10, 60);
  ground.date = date;
  return std::make_shared<const Terrain>(procedural_terrain(ground));
}

MapDefects map_defects(const LocateEvalOptions& o, int map) {
  const double pixel = 0.5 * (kLowest + kHighest) / o.camera.fx;
  const uint64_t seed = counter_word(o.seed + 1, static_cast<uint64_t>(map));
  MapDefects defects = o.perfect ? MapDefects{} : o.season ? draw_season(seed, pixel) : draw_defects(seed, pixel);
  if (o.texel > 0) defects.texel = o.texel;
  return defects;
}

void measure(LocateSample& sample, const Shot& shot, const Camera& camera, double texel) {
  const SE3& pose = sample.located.T_WC;
  double sum = 0;
  int count = 0;
  for (int v = 20; v < camera.height; v += 40)
    for (int u = 20; u < camera.width; u += 40, ++count) {
      const double depth = shot.view.depth[static_cast<size_t>(v * camera.width + u)];
      const Eigen::Vector3d X = pose.inverse() * (shot.T_WC * Eigen::Vector3d(depth * camera.ray({u, v})));
      sum += X.z() > 0 ? (camera.project(X) - Eigen::Vector2d(u, v)).norm() * depth / camera.fx : 1e9;
    }
  sample.texels = sum / count / texel;
  sample.metres = (pose.t - shot.T_WC.t).norm();
  sample.degrees = SE3{pose.R.transpose() * shot.T_WC.R, Eigen::Vector3d::Zero()}.angle() / kDegree;
  sample.nees = normalised_error(pose, sample.located.covariance, shot.T_WC);
}

LocatePrior prior_of(const Shot& shot, const LocateEvalOptions& o) {
  const double angle = 0.5 * o.degrees * kDegree;
  return {shot.prior, 0.5 * o.metres, 0.5 * o.metres, angle, o.heading ? angle : M_PI};
}

/// A view of the map at the prior, as peers get it.
PeerPair peer_pair(const Shot& shot, const View& map, const Camera& camera) {
  PeerPair pair;
  pair.image_0 = bgr_of(map), pair.image_1 = shot.image;
  pair.grey_0 = grey_8bit(pair.image_0), pair.grey_1 = grey_8bit(pair.image_1);
  pair.depth_0 = with_nan(depth_of(map));
  pair.camera = camera;
  return pair;
}

/// A line of a manifest of `iclk batch`.
std::string export_pair(const std::string& folder, const std::string& name, const View& map, const Shot& shot,
                        const Camera& c) {
  const auto write = [&](const std::string& file, const std::string& bytes) {
    write_file((fs::path(folder) / file).string(), bytes);
    return file;
  };
  nlohmann::ordered_json line = {{"id", name}, {"camera", {c.fx, c.fy, c.cx, c.cy}}};
  line["reference"] = write("images/" + name + "_0.png", encode_view(map));
  line["target"] = write("images/" + name + "_1.png", encode_png(shot.image));
  line["depth"] = write("depth/" + name + ".tiff", encode_depth(map));
  line["truth"] = pose_json(shot.T_WC.inverse() * shot.prior);
  return line.dump() + "\n";
}

class Run {
 public:
  Run(const LocateEvalOptions& options, const Progress& progress)
      : o_(options), progress_(progress), device_(open_device(o_.device)) {
    eval_.methods.push_back({"iclk", {}});
    if (o_.peers) peers_.push_back(make_sift_pnp());
    for (const auto& peer : peers_) eval_.methods.push_back({peer->name(), {}});
    for (const char* part : {"images", "depth"})
      if (!o_.export_to.empty()) make_output_folder((fs::path(o_.export_to) / part).string());
  }

  LocateEval all() {
    for (int map = 0; map < o_.maps; ++map) one_map(map);
    if (!o_.export_to.empty()) write_file((fs::path(o_.export_to) / "pairs.jsonl").string(), manifest_);
    return std::move(eval_);
  }

 private:
  void one_map(int map) {
    const MapDefects defects = map_defects(o_, map);
    const auto& dates = defects.dates;
    const auto ground = make_ground(o_, map, dates ? std::optional(dates->frames) : std::nullopt);
    const auto mapped = dates ? make_ground(o_, map, dates->map) : ground;
    const auto known = std::make_shared<const Terrain>(degraded(*mapped, defects));
    eval_.maps.push_back(defects);
    TerrainRenderer camera(device_, ground, {.samples = 3});
    Locator locator(device_, known, o_.locator);
    for (int frame = map * o_.frames / o_.maps; frame < (map + 1) * o_.frames / o_.maps; ++frame) {
      if (progress_) progress_("locating", frame, o_.frames);
      Random random(counter_word(o_.seed + 2, static_cast<uint64_t>(frame)));
      const Shot shot = draw_shot(camera, o_, random);
      LocateSample sample{.map = map, .frame = frame};
      const internal::Stopwatch time;
      const CpuStopwatch cpu;
      sample.located = locator.locate(view(shot.image), o_.camera, prior_of(shot, o_));
      sample.ms = time.ms(), sample.cpu_ms = cpu.ms();
      measure(sample, shot, o_.camera, known->mosaic.step_x);
      eval_.methods[0].samples.push_back(sample);
      run_peers(shot, locator, map, frame, known->mosaic.step_x);
    }
  }

  void run_peers(const Shot& shot, Locator& locator, int map, int frame, double texel) {
    if (peers_.empty() && o_.export_to.empty()) return;
    View seen;
    try {
      seen = locator.view(o_.camera, shot.prior);
    } catch (const Error&) {  // a prior below the ground
    }
    for (size_t i = 0; i < peers_.size(); ++i) {
      LocateSample sample{.map = map, .frame = frame};
      sample.located.T_WC = shot.prior;
      const internal::Stopwatch time;
      const CpuStopwatch cpu;
      const PeerAnswer answer = seen.rgba.empty() ? PeerAnswer{} : peers_[i]->run(peer_pair(shot, seen, o_.camera));
      sample.ms = time.ms(), sample.cpu_ms = cpu.ms();
      if (answer.claimed) sample.located.status = Status::converged;
      if (answer.has_pose) sample.located.T_WC = shot.prior * answer.T_10.inverse();
      measure(sample, shot, o_.camera, texel);
      sample.nees = NAN;
      eval_.methods[i + 1].samples.push_back(sample);
    }
    if (!o_.export_to.empty() && !seen.rgba.empty())
      manifest_ += export_pair(o_.export_to, std::to_string(frame), seen, shot, o_.camera);
  }

  const LocateEvalOptions& o_;
  const Progress& progress_;
  std::shared_ptr<engine::Context> device_;
  std::vector<std::unique_ptr<PeerMethod>> peers_;
  std::string manifest_;
  LocateEval eval_;
};

}  // namespace

void LocateEvalOptions::check() const {
  if (frames < 1 || maps < 1 || maps > frames) refuse("--maps must be at least 1 and at most --frames");
  if (!(metres >= 0 && degrees >= 0 && texel >= 0 && elsewhere >= 0))
    refuse("--prior, --texel and --elsewhere must not be negative");
  if (ortho.empty() != elevation.empty()) refuse("--ortho and --elevation must be given together");
  if (season && (perfect || !ortho.empty()))
    refuse("--season is for procedural ground with defects: leave out --ortho and --perfect");
}

LocateEval run_locate_eval(const LocateEvalOptions& options, const Progress& progress) {
  options.check();
  return Run(options, progress).all();
}

}  // namespace iclk
