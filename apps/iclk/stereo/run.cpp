#include "apps/iclk/stereo/run.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/sequence.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/iclk/stereo/output.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> images_of(const std::string& folder) {
  std::vector<std::string> files;
  for (const fs::path& file : list_files(folder)) files.push_back(file.string());
  if (files.empty()) throw Error(ErrorCode::invalid_argument, folder + ": no images in this folder");
  return files;
}

/// A pair in memory, as the left pinhole sees it.
struct Loaded {
  cv::Mat left, right, mask;
  Features features;
};

class Loader {
 public:
  explicit Loader(const StereoRunOptions& options) : options_(options) {
    const cv::Mat left = load_image(options.pairs.front().left), right = load_image(options.pairs.front().right);
    camera = fit_camera(options.calibration.left, left.cols, left.rows);
    right_ = fit_camera(options.calibration.right, right.cols, right.rows);
    undistort_left_.emplace(camera, options.calibration.left.distortion);
    undistort_right_.emplace(right_, options.calibration.right.distortion, camera);
  }

  Loaded load(const StereoFiles& files) const {
    Loaded out;
    cv::Mat left = image(files.left, camera), right = image(files.right, right_);
    if (left.size() == right.size() && left.type() == right.type() && cv::norm(left, right, cv::NORM_INF) == 0)
      throw Error(ErrorCode::invalid_argument,
                  files.left + " and " + files.right + " are the same image; give a left and a right one");
    const Levels levels{left, right};
    levels.apply(left);
    levels.apply(right);
    out.left = undistort_left_->image(left);
    out.right = undistort_right_->image(right);
    out.mask = undistort_right_->seen();
    cv::Mat depth;
    if (!files.depth.empty()) {
      depth = load_depth(files.depth, options_.depth_scale);
      check_size(depth, files.depth, camera);
      depth = undistort_left_->depth(depth);
      if (options_.depth_along_ray) along_axis(camera, depth);
    }
    if (!files.features.empty()) {
      out.features = load_features(files.features);
      for (Eigen::Vector2d& uv : out.features.uv) uv = undistort_left_->point(uv);
      if (options_.depth_along_ray) along_axis(camera, out.features);
    } else {
      if (depth.empty() && options_.distance > 0)
        depth = cv::Mat(camera.height, camera.width, CV_32FC1, cv::Scalar(options_.distance));
      if (depth.empty())
        throw Error(
            ErrorCode::invalid_argument,
            files.left + " has neither depth nor features; give --depth, or without any --distance METRES (approximate)");
      out.features = detect_features(view(out.left), view(depth), view(undistort_left_->seen()), options_.detector);
    }
    if (out.features.inverse_depth_sigma.empty()) options_.depth_sigma.apply(camera, out.features);
    return out;
  }

  Camera camera;

 private:
  static void check_size(const cv::Mat& m, const std::string& path, const Camera& camera) {
    if (m.cols != camera.width || m.rows != camera.height)
      throw Error(ErrorCode::invalid_argument, fmt::format("{} has {}x{} pixels, but the camera of the first pair has {}x{}",
                                                           path, m.cols, m.rows, camera.width, camera.height));
  }
  static cv::Mat image(const std::string& path, const Camera& camera) {
    cv::Mat m = load_image(path);
    check_size(m, path, camera);
    return m;
  }

  const StereoRunOptions& options_;
  Camera right_;
  std::optional<Undistorter> undistort_left_, undistort_right_;
};

RigPair pair_of(const Loaded& l) {
  return {view(l.left), view(l.right), l.features, l.mask.empty() ? ImageView{} : view(l.mask)};
}

/// px, means of |rectified_error| by the prior and by each moment's own extrinsics.
void add_epipolar(const Camera& camera, const std::vector<std::vector<RigSighting>>& found, StereoReport& report) {
  double before = 0, after = 0;
  int count = 0;
  for (size_t i = 0; i < found.size(); ++i)
    for (const RigSighting& s : found[i]) {
      const double a = rectified_error(camera, camera, report.prior, s.left, s.right),
                   b = rectified_error(camera, camera, report.flex.states[i].T_rl, s.left, s.right);
      if (!std::isfinite(a) || !std::isfinite(b)) continue;
      before += std::abs(a), after += std::abs(b);
      ++count;
    }
  if (count == 0) return;
  report.epipolar_before = before / count;
  report.epipolar_after = after / count;
}

void run_flex(const StereoRunOptions& options, const std::vector<RigPair>& pairs, const Session& session,
              StereoReport& report) {
  const auto aligned = align_pairs(session, report.camera, pairs, report.prior, options.rig.refiner, options.rig.search);
  std::vector<std::vector<RigSighting>> found(pairs.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    const RefinedAlignment& r = aligned[i];
    const double time = options.pairs[i].time.value_or(static_cast<double>(i) / options.rate);
    const bool valid = usable(r.status) && r.refined && r.covariance.diagonal().minCoeff() > 0;
    report.measurements.push_back({time, r.T_10, r.covariance, valid});
    report.reasons.push_back(r.reason);
    for (size_t k = 0; valid && k < r.features.size(); ++k)
      if (r.features[k].status == FeatureStatus::aligned)
        found[i].push_back({static_cast<int>(i), pairs[i].features.uv[k], r.features[k].uv1, r.features[k].covariance, 1, 0});
  }
  report.flex = smooth_flex(report.measurements, options.bending);
  if (report.flex.usable) add_epipolar(report.camera, found, report);
}

void write_results(const StereoRunOptions& options, const StereoReport& report, const StereoImages& images, size_t shown) {
  const auto write = [&](const std::string& name, const std::string& text) {
    write_file((fs::path(options.out) / name).string(), text);
  };
  if (report.usable()) {
    const SE3 after = options.flex ? report.flex.states[shown].T_rl : report.rig.T_rl;
    write("epipolar.png", encode_png(epipolar_picture(images, report.camera, report.prior, after)));
    if (options.flex) write("series.csv", series_csv(report));
    for (const auto& [name, text] : with_extrinsics(options.calibration, options.flex ? report.flex.mean : report.rig.T_rl)) {
      make_output_folder((fs::path(options.out) / name).parent_path().string());
      write(name, text);
    }
  }
  write("result.json", result_json(options, report));
}

}  // namespace

std::vector<StereoFiles> list_pairs(const std::string& left, const std::string& right, const std::string& depth) {
  const std::vector<std::string> l = images_of(left), r = images_of(right),
                                 d = depth.empty() ? std::vector<std::string>() : images_of(depth);
  if (l.size() != r.size() || (!depth.empty() && l.size() != d.size()))
    throw Error(ErrorCode::invalid_argument,
                fmt::format("{} has {} files, {} {}{}: they are paired by the order of their names", left, l.size(), right,
                            r.size(), depth.empty() ? "" : fmt::format(", {} {}", depth, d.size())));
  std::vector<StereoFiles> pairs;
  for (size_t i = 0; i < l.size(); ++i) pairs.push_back({l[i], r[i], depth.empty() ? "" : d[i], "", std::nullopt});
  return pairs;
}

std::vector<StereoFiles> list_pairs(const std::string& path) {
  std::error_code ignored;
  if (fs::is_directory(path, ignored)) {
    const fs::path folder(path);
    const fs::path depth = folder / "depth";
    return list_pairs((folder / "left").string(), (folder / "right").string(),
                      fs::is_directory(depth, ignored) ? depth.string() : "");
  }
  const std::string text = read_file(path);
  const fs::path folder = fs::path(path).parent_path();
  std::vector<StereoFiles> pairs;
  int number = 0;
  for (const std::string_view line : lines_of(text)) {
    ++number;
    if (trim(line).empty()) continue;
    const std::string where = fmt::format("{}:{}", path, number);
    const auto fail = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, where + ": " + why); };
    std::string why;
    const nlohmann::ordered_json json = parse_json(line, &why);
    if (!json.is_object()) fail(why.empty() ? "must be a JSON object" : why);
    StereoFiles files;
    for (const auto& [key, value] : json.items()) {
      if (value.is_null() || key == "meta") continue;
      if (key == "time") {
        if (!value.is_number() || !std::isfinite(value.get<double>())) fail("key 'time' is not a number");
        files.time = value.get<double>();
        continue;
      }
      std::string* to = key == "left"       ? &files.left
                        : key == "right"    ? &files.right
                        : key == "depth"    ? &files.depth
                        : key == "features" ? &files.features
                                            : nullptr;
      if (to == nullptr) fail("unknown key '" + printable(key) + "'; known are left, right, depth, features, time and meta");
      if (!value.is_string() || value.get<std::string>().empty()) fail("key '" + key + "' is not the name of a file");
      *to = (folder / value.get<std::string>()).string();
    }
    if (files.left.empty() || files.right.empty()) fail("keys 'left' and 'right' are required");
    if (!pairs.empty() && pairs.front().time.has_value() != files.time.has_value())
      fail("key 'time' must be in all lines or in none");
    pairs.push_back(files);
  }
  if (pairs.empty()) throw Error(ErrorCode::invalid_argument, path + ": there are no pairs");
  return pairs;
}

StereoReport run_stereo(const StereoRunOptions& options, const std::function<void(int, int)>& progress) {
  if (options.pairs.empty()) throw Error(ErrorCode::invalid_argument, "there are no pairs");
  options.rig.check();
  options.bending.check();
  const internal::Stopwatch watch;
  const Loader loader(options);
  StereoReport report;
  report.prior = options.calibration.T_rl;
  report.camera = loader.camera;
  std::vector<Loaded> loaded;
  std::vector<RigPair> pairs;
  const int total = static_cast<int>(options.pairs.size());
  for (const StereoFiles& files : options.pairs) {
    loaded.push_back(loader.load(files));
    progress(static_cast<int>(loaded.size()), total);
  }
  for (const Loaded& l : loaded) pairs.push_back(pair_of(l));

  const Session session({.model = "classical",
                         .device = options.device,
                         .solver = options.solver,
                         .search = options.rig.search ? SearchMode::automatic : SearchMode::off,
                         .batch = options.batch});
  report.device = session.context() ? session.device_name() : "CPU";
  report.cpu_unasked = session.cpu_unasked();
  if (!options.out.empty()) make_output_folder(options.out);
  if (options.flex)
    run_flex(options, pairs, session, report);
  else
    report.rig = estimate_rig(session, loader.camera, pairs, report.prior, options.rig);
  report.seconds = watch.ms() / 1000;
  if (options.out.empty()) return report;
  size_t shown = 0;  // the first pair that says something
  for (size_t i = pairs.size(); i-- > 0;)
    if (options.flex ? report.measurements[i].valid : report.rig.pairs[i].used) shown = i;
  write_results(options, report, {loaded[shown].left, loaded[shown].right}, shown);
  return report;
}

std::string to_text(const StereoReport& report) {
  if (report.flex.usable) {
    const auto valid =
        std::count_if(report.measurements.begin(), report.measurements.end(), [](const auto& m) { return m.valid; });
    double rotation = 0, translation = 0;
    for (const FlexState& s : report.flex.states) {
      rotation = std::max(rotation, (report.flex.mean.inverse() * s.T_rl).angle());
      translation = std::max(translation, (report.flex.mean.inverse() * s.T_rl).t.norm());
    }
    return fmt::format(
        "pairs      {} of {} have a pose of their own\nbending    up to {:.3f} degrees and {:.4g} m from the mean\n"
        "epipolar   {:.3f} px before, {:.3f} px after\ndevice     {}, {:.1f} s\n",
        valid, report.measurements.size(), rotation / kDegree, translation, report.epipolar_before, report.epipolar_after,
        report.device, report.seconds);
  }
  const RigResult& r = report.rig;
  if (!r.usable)
    return fmt::format("no result  {}\n",
                       report.measurements.empty() ? r.reason : "no pair could be aligned: " + report.reasons[0]);
  const SE3 change = report.prior.inverse() * r.T_rl;
  return fmt::format(
      "the rig {}: by {:.4f} +- {:.4f} degrees and {:.4g} +- {:.2g} m (chi-square {:.4g}; a move is above {:.1f})\n"
      "pairs      {}\n"
      "epipolar   {:.3f} px before, {:.3f} px after\n"
      "{}device     {}, {:.1f} s\n",
      r.moved ? "has moved" : "has not moved", change.angle() / kDegree,
      std::sqrt(r.covariance.bottomRightCorner<3, 3>().trace()) / kDegree, change.t.norm(),
      std::sqrt(r.covariance.topLeftCorner<3, 3>().trace()), r.chi_square, r.threshold, r.reason, r.epipolar_before,
      r.epipolar_after,
      r.scale_from_prior ? "scale      from the old calibration: the images do not show the length of the baseline\n" : "",
      report.device, report.seconds);
}

}  // namespace iclk
