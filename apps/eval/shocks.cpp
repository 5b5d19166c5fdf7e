// The figures of docs/results/stereo.md: a rendered rig, knocked or bending, by iclk::rig and by SIFT with the same adjustment.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>
#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/rig/flex.h>
#include <iclk/rig/rig.h>
#include <iclk/session/detect.h>
#include <iclk/session/device.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/undistorter.h"

namespace iclk {
namespace {

constexpr double kDepthNoise = 0.005;
const Camera kCamera{300, 300, 187.5, 119.5, 376, 240};
const SE3 kRest{Eigen::Matrix3d::Identity(), {-1.5, 0, 0}};

struct Settings {
  int draws = 50, pairs = 20, frames = 60, features = 200;
  double rate = 30;
  std::vector<double> degrees = {1, 3};
  bool no_peer = false;
  std::string device;
};

using Random = std::mt19937;

Eigen::Vector3d direction(Random& random) {
  std::normal_distribution<double> normal;
  return Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
}

/// As a camera with this exposure and noise has it.
cv::Mat photograph(const View& view, double gain, double bias, uint64_t seed) {
  const cv::Mat rgba(view.height, view.width, CV_8UC4, const_cast<uint32_t*>(view.rgba.data()));
  cv::Mat grey, out, noise(view.height, view.width, CV_32FC1);
  cv::cvtColor(rgba, grey, cv::COLOR_RGBA2GRAY);
  grey.convertTo(out, CV_32FC1, gain, bias);
  cv::RNG(seed).fill(noise, cv::RNG::NORMAL, 0, 1.5);
  cv::Mat(out + noise).convertTo(out, CV_8UC1);
  return out;
}

struct LeftView {
  SE3 T_WC;
  cv::Mat image, depth;
  Features features;
};

class World {
 public:
  explicit World(const Settings& settings)
      : settings_(settings),
        context_(open_device(settings.device)),
        renderer_(context_, std::make_shared<const Terrain>(procedural_terrain(
                                {.seed = 7, .size = 160, .mosaic_step = 0.06, .relief_step = 0.4, .relief = 20}))) {}

  LeftView left(double x, double y, double heading, double tilt, uint64_t seed) {
    Eigen::Matrix3d down;
    down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    LeftView v;
    v.T_WC = {Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()).toRotationMatrix() * down *
                  Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitX()).toRotationMatrix(),
              {x, y, renderer_.terrain().height_at(x, y).value_or(0) + 25}};
    const View view = renderer_.render(kCamera, v.T_WC);
    v.image = photograph(view, 1, 0, 2 * seed);
    v.depth = cv::Mat(view.height, view.width, CV_32FC1, const_cast<float*>(view.depth.data())).clone();
    v.features = detect_features(iclk::view(v.image), iclk::view(v.depth), {}, {.count = settings_.features});
    return v;
  }
  cv::Mat right(const LeftView& v, const SE3& T_rl, uint64_t seed) {
    return photograph(renderer_.render(kCamera, v.T_WC * T_rl.inverse()), 0.85, 12, 2 * seed + 1);
  }
  std::unique_ptr<Aligner> aligner(int pairs) {
    const Session session({.model = "classical", .solver = Solver::device}, context_);
    return session.make_aligner(rig_plan(kCamera, settings_.features, pairs));
  }
  const std::string& device() const { return context_->info().name; }

 private:
  Settings settings_;
  std::shared_ptr<engine::Context> context_;
  TerrainRenderer renderer_;
};

/// With errors of their depths.
Features measured(const Features& exact, uint64_t seed) {
  Features features = exact;
  Random random(static_cast<unsigned>(seed));
  std::normal_distribution<double> normal;
  for (double& q : features.inverse_depth) {
    features.inverse_depth_sigma.push_back(kDepthNoise * q);
    q *= 1 + kDepthNoise * normal(random);
  }
  return features;
}

ImageView view_of(const cv::Mat& m) { return {m.data, m.cols, m.rows, m.step, PixelFormat::r8}; }

/// SIFT in all pairs, each pair's matches that pass the ratio test and its essential matrix, the pose of the pair with most of
/// them, and adjust_rig() over all with depths of the left image (exact ones, stated as being as wrong as ours).
SE3 by_sift(const std::vector<LeftView>& lefts, const std::vector<cv::Mat>& rights, bool& found) {
  const auto sift = cv::SIFT::create(4000);
  const cv::BFMatcher matcher(cv::NORM_L2);
  const cv::Mat K = camera_matrix(kCamera);
  std::vector<RigSighting> sightings;
  SE3 best = kRest;
  int most = 0;
  for (size_t i = 0; i < lefts.size(); ++i) {
    std::vector<cv::KeyPoint> a, b;
    cv::Mat da, db;
    sift->detectAndCompute(lefts[i].image, {}, a, da);
    sift->detectAndCompute(rights[i], {}, b, db);
    if (a.size() < 8 || b.size() < 8) continue;
    std::vector<std::vector<cv::DMatch>> matches;
    matcher.knnMatch(da, db, matches, 2);
    std::vector<cv::Point2d> pa, pb;
    for (const auto& m : matches)
      if (m.size() == 2 && m[0].distance < 0.8f * m[1].distance) {
        pa.push_back(a[static_cast<size_t>(m[0].queryIdx)].pt);
        pb.push_back(b[static_cast<size_t>(m[0].trainIdx)].pt);
      }
    if (pa.size() < 8) continue;
    cv::Mat inliers, R, t;
    const cv::Mat E = cv::findEssentialMat(pa, pb, K, cv::RANSAC, 0.999, 1.0, inliers);
    if (E.rows != 3) continue;
    const int count = cv::recoverPose(E, pa, pb, K, R, t, inliers);
    if (count > most) {
      most = count;
      for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) best.R(r, c) = R.at<double>(r, c);
        best.t[r] = t.at<double>(r) * kRest.t.norm();
      }
    }
    for (size_t k = 0; k < pa.size(); ++k) {
      if (!inliers.at<uchar>(static_cast<int>(k))) continue;
      const float z = lefts[i].depth.at<float>(static_cast<int>(std::lround(pa[k].y)), static_cast<int>(std::lround(pa[k].x)));
      if (!(z > 0)) continue;
      sightings.push_back(
          {static_cast<int>(i), {pa[k].x, pa[k].y}, {pb[k].x, pb[k].y}, Eigen::Matrix2d::Zero(), 1.0 / z, kDepthNoise / z});
    }
  }
  const RigAdjustment r = adjust_rig(kCamera, kCamera, sightings, best);
  found = r.usable;
  return r.T_rl;
}

/// px: mean rectified error of what the cameras really see, if it is rectified by T_rl.
double true_epipolar(const std::vector<LeftView>& lefts, const SE3& truth, const SE3& T_rl) {
  double sum = 0;
  int count = 0;
  for (const LeftView& l : lefts)
    for (int v = 8; v < kCamera.height; v += 16)
      for (int u = 8; u < kCamera.width; u += 16) {
        const Eigen::Vector2d uv(u, v);
        const Eigen::Vector3d X = truth * (kCamera.ray(uv) * static_cast<double>(l.depth.at<float>(v, u)));
        if (!(X.z() > 0) || !kCamera.contains(kCamera.project(X))) continue;
        sum += std::abs(rectified_error(kCamera, kCamera, T_rl, uv, kCamera.project(X)));
        ++count;
      }
  return sum / std::max(count, 1);
}

struct Column {
  std::vector<double> rotation, translation, epipolar;
  int failed = 0;
  void add(const std::vector<LeftView>& lefts, const SE3& truth, const SE3& T_rl, bool found) {
    failed += !found;
    if (!found) return;
    rotation.push_back((T_rl.inverse() * truth).angle() / kDegree);
    translation.push_back(1e3 * (T_rl.t - truth.t).norm());
    epipolar.push_back(true_epipolar(lefts, truth, T_rl));
  }
  std::string row(const std::string& name) {
    const auto text = [](std::vector<double>& values, int digits) {
      if (values.empty()) return std::string("-");
      std::sort(values.begin(), values.end());
      return fmt::format("{:.{}f} / {:.{}f}", values[values.size() / 2], digits, values.back(), digits);
    };
    int within = 0;
    for (size_t i = 0; i < rotation.size(); ++i) within += rotation[i] <= 0.02 && epipolar[i] <= 0.2;
    const int draws = static_cast<int>(rotation.size());
    return fmt::format("| {} | {} | {} | {} | {} of {} |\n", name, text(rotation, 4), text(translation, 2), text(epipolar, 3),
                       within, draws + failed);
  }
};

void shocks(World& world, const Settings& settings) {
  Random random(1);
  std::uniform_real_distribution<double> place(40, 120), turn(-M_PI, M_PI), tilt(0, 0.35);
  std::vector<LeftView> lefts;
  for (int i = 0; i < settings.pairs; ++i)
    lefts.push_back(world.left(place(random), place(random), turn(random), tilt(random), static_cast<uint64_t>(i)));
  const auto aligner = world.aligner(settings.pairs);
  fmt::print("{} draws of {} pairs, {}x{}, {} features, {}\n", settings.draws, settings.pairs, kCamera.width, kCamera.height,
             settings.features, world.device());
  for (const double degrees : settings.degrees) {
    Column ours, sift;
    int moved = 0;
    double nees = 0, before = 0;
    for (int d = 0; d < settings.draws; ++d) {
      Vector6d xi;
      xi << (degrees > 0 ? 0.005 : 0) * direction(random), degrees * kDegree * direction(random);
      const SE3 truth = kRest * SE3::exp(xi);
      std::vector<cv::Mat> rights;
      std::vector<RigPair> pairs;
      for (size_t i = 0; i < lefts.size(); ++i) {
        const uint64_t seed = 1000 + 100 * static_cast<uint64_t>(d);
        rights.push_back(world.right(lefts[i], truth, seed + i));
        pairs.push_back({view_of(lefts[i].image), view_of(rights.back()), measured(lefts[i].features, seed + i), {}});
      }
      const RigResult r = estimate_rig(*aligner, kCamera, pairs, kRest);
      ours.add(lefts, truth, r.T_rl, r.usable);
      moved += r.moved;
      before += true_epipolar(lefts, truth, kRest) / settings.draws;
      const Vector6d e = (r.T_rl.inverse() * truth).log();
      if (r.usable) nees += e.dot(Matrix6d(r.covariance.inverse()) * e) / 6 / settings.draws;
      if (settings.no_peer) continue;
      bool found = false;
      const SE3 T = by_sift(lefts, rights, found);
      sift.add(lefts, truth, T, found);
    }
    fmt::print(
        "\nshock of {} degrees and {} mm, epipolar error before {:.2f} px; reported as moved: {}; NEES / 6: {:.2f}\n\n"
        "| | rotation, degrees, median / max | t, mm | epipolar, px | <= 0.02 degrees and 0.2 px |\n|---|---|---|---|---|\n",
        degrees, degrees > 0 ? 5 : 0, before, moved, nees);
    fmt::print("{}", ours.row("iclk stereo"));
    if (!settings.no_peer) fmt::print("{}", sift.row("SIFT, essential matrix, the same adjustment"));
    std::fflush(stdout);
  }
}

void flex(World& world, const Settings& settings) {
  const auto aligner = world.aligner(20);
  std::vector<LeftView> lefts;
  for (int i = 0; i < settings.frames; ++i)
    lefts.push_back(world.left(60 + 0.5 * i, 70 + 0.2 * i, 0.3, 0.2, 500 + static_cast<uint64_t>(i)));
  fmt::print(
      "\nbending by 3 degrees and 5 cm, {} frames at {} Hz\n\n| Hz | RMSE by pair, degrees | smoothed | t, mm | valid |\n"
      "|---|---|---|---|---|\n",
      settings.frames, settings.rate);
  for (const double frequency : {1.0, 2.0, 4.0, 8.0}) {
    std::vector<cv::Mat> rights;
    std::vector<RigPair> pairs;
    std::vector<SE3> truth;
    for (int i = 0; i < settings.frames; ++i) {
      const double a = std::sin(2 * M_PI * frequency * i / settings.rate + 0.4);
      Vector6d xi;
      xi << a * 0.05 * Eigen::Vector3d(0, 0.3, 1).normalized(), a * 3 * kDegree * Eigen::Vector3d(0.4, 0.3, 1).normalized();
      truth.push_back(kRest * SE3::exp(xi));
      const LeftView& l = lefts[static_cast<size_t>(i)];
      rights.push_back(world.right(l, truth.back(), 9000 + static_cast<uint64_t>(i)));
      pairs.push_back({view_of(l.image), view_of(rights.back()), measured(l.features, 700 + static_cast<uint64_t>(i)), {}});
    }
    std::vector<FlexMeasurement> measurements;
    const auto aligned = align_pairs(*aligner, kCamera, pairs, kRest, {}, true);
    int valid = 0;
    for (size_t i = 0; i < aligned.size(); ++i) {
      measurements.push_back({static_cast<double>(i) / settings.rate, aligned[i].T_10, aligned[i].covariance,
                              usable(aligned[i].status) && aligned[i].refined});
      valid += measurements.back().valid;
    }
    const FlexResult r = smooth_flex(measurements);
    double by_pair = 0, smoothed = 0, metres = 0;
    for (size_t i = 0; i < r.states.size(); ++i) {
      if (measurements[i].valid) by_pair += std::pow((measurements[i].T_rl.inverse() * truth[i]).angle() / kDegree, 2) / valid;
      smoothed += std::pow((r.states[i].T_rl.inverse() * truth[i]).angle() / kDegree, 2) / settings.frames;
      metres += (r.states[i].T_rl.t - truth[i].t).squaredNorm() / settings.frames;
    }
    fmt::print("| {} | {:.4f} | {:.4f} | {:.1f} | {} of {} |\n", frequency, std::sqrt(by_pair), std::sqrt(smoothed),
               1e3 * std::sqrt(metres), valid, settings.frames);
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace iclk

int main(int argc, char** argv) {
  iclk::Settings settings;
  CLI::App app("Measures shocks and bending of rendered stereo rigs: prints the tables of docs/results/stereo.md");
  app.add_option("--draws", settings.draws, "Number of shocks of each size")->capture_default_str()->check(CLI::PositiveNumber);
  app.add_option("--pairs", settings.pairs, "Pairs per shock")->capture_default_str()->check(CLI::PositiveNumber);
  app.add_option("--frames", settings.frames, "Frames of each bending rig")->capture_default_str()->check(CLI::PositiveNumber);
  app.add_option("--degrees", settings.degrees, "Sizes of the shocks, degrees; each also moves the camera by 5 mm; 0: no shock")
      ->capture_default_str();
  app.add_flag("--no-peer", settings.no_peer, "Leave SIFT out");
  app.add_option("--device", settings.device, "Vulkan device: index, UUID or part of the name");
  CLI11_PARSE(app, argc, argv);
  try {
    iclk::World world(settings);
    iclk::shocks(world, settings);
    iclk::flex(world, settings);
  } catch (const iclk::Error& e) {
    fmt::print(stderr, "iclk_rig_shocks: {}\n", e.what());
    return 1;
  }
}
