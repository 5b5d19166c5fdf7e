#include "apps/track/run.h"

#include <chrono>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>

#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>

#include "apps/io/images.h"
#include "apps/io/output.h"
#include "apps/io/pose_text.h"
#include "apps/session/any_aligner.h"
#include "apps/session/model_lookup.h"
#include "apps/track/output.h"

namespace iclk {
namespace {

constexpr int kRelativeFrames = 30;

/// A file that grows line by line.
class Growing {
 public:
  Growing(const std::string& folder, const std::string& name) {
    if (folder.empty()) return;
    path_ = (std::filesystem::path(folder) / name).string();
    file_.open(path_, std::ios::trunc);
    check();
  }
  void add(const std::string& text) {
    if (path_.empty()) return;
    file_ << text << std::flush;
    check();
  }

 private:
  void check() {
    if (!file_) throw Error(ErrorCode::io, path_ + ": cannot be written, is the disk full?");
  }
  std::string path_;
  std::ofstream file_;
};

TrackErrors errors_of(const std::vector<PosePair>& pairs) {
  return {absolute_error(pairs), relative_error(pairs, kRelativeFrames), way_length(pairs), static_cast<int>(pairs.size())};
}

/// A recording's frames as a tracker takes them.
class Frames {
 public:
  explicit Frames(const TrackRunOptions& options) : sequence_(load_sequence(options.folder)) {
    if (!options.camera && !sequence_.camera) throw Error(ErrorCode::io, options.folder + " has no camera.txt: give --camera");
    const CameraFile file = options.camera ? *options.camera : *sequence_.camera;
    scale_ = options.depth_scale > 0 ? options.depth_scale : file.depth_scale;
    distortion_ = options.distortion.value_or(file.distortion);
    const int end = static_cast<int>(sequence_.frames.size());
    for (int i = options.first; i < end && (options.count == 0 || size() < options.count); i += options.stride)
      chosen_.push_back(static_cast<size_t>(i));
    if (chosen_.empty())
      throw Error(ErrorCode::invalid_argument, options.folder + " has " + std::to_string(end) + " frames, none of them from " +
                                                   std::to_string(options.first) + " on");
    const cv::Mat first = load_image(frame(0).image);
    camera = fit_camera(file, first.cols, first.rows);
    undistorter_.emplace(camera, distortion_);
  }
  int size() const { return static_cast<int>(chosen_.size()); }
  const SequenceFrame& frame(int i) const { return sequence_.frames[chosen_[static_cast<size_t>(i)]]; }
  bool masks() const { return !distortion_.empty(); }

  /// Valid until the next call.
  TrackFrame load(int i) {
    const SequenceFrame& f = frame(i);
    image_ = load_image(f.image);
    depth_ = f.depth.empty() ? cv::Mat() : load_depth(f.depth, scale_);
    for (const cv::Mat* m : {&image_, &depth_})
      if (!m->empty() && (m->cols != camera.width || m->rows != camera.height))
        throw Error(ErrorCode::invalid_argument,
                    fmt::format("{} has {}x{} pixels, the first image {}x{}", m == &image_ ? f.image : f.depth, m->cols,
                                m->rows, camera.width, camera.height));
    TrackFrame out{.time = f.stamp, .image = {}, .depth = {}, .mask = {}};
    if (masks()) {
      image_ = undistorter_->image(image_);
      if (!depth_.empty()) depth_ = undistorter_->depth(depth_);
      out.mask = view(undistorter_->seen());
    }
    out.image = view(image_);
    if (!depth_.empty()) out.depth = view(depth_);
    return out;
  }

  Camera camera;

 private:
  Sequence sequence_;
  std::vector<size_t> chosen_;
  double scale_ = 0;
  Distortion distortion_;
  std::optional<Undistorter> undistorter_;
  cv::Mat image_, depth_;
};

void write_results(const TrackRunOptions& options, const Tracker& tracker, const Camera& camera,
                   const std::vector<TrackedFrame>& frames, const TrackReport& report) {
  const auto write = [&](const char* name, const std::string& text) {
    write_file((std::filesystem::path(options.out) / name).string(), text);
  };
  std::vector<SE3> poses;
  for (int id = 0; id < tracker.keyframe_count(); ++id) poses.push_back(tracker.keyframe_pose(id));
  std::vector<TrackedFrame> keyframes;
  for (const TrackedFrame& f : frames)
    if (f.result.status == TrackStatus::keyframe) keyframes.push_back(f);
  write("trajectory.txt", tum_text(frames));
  write("trajectory_kitti.txt", kitti_text(frames));
  write("keyframes.txt", tum_text(keyframes));
  write("map.ply", map_ply(tracker, camera));
  write("path.png", path_png(frames, poses, report.adjusted ? &*report.adjusted : nullptr));
}

}  // namespace

TrackReport track_sequence(const TrackRunOptions& options, const std::function<void(int, int, int)>& progress) {
  Frames frames(options);
  TrackerOptions how = options.tracker;
  how.masks = how.masks || frames.masks();
  AlignerOptions aligner_options;
  std::shared_ptr<const Model> model;
  if (options.model != "classical") {
    model = std::make_shared<const Model>(load_model(find_model(options.model)));
    aligner_options = model->options();
  }
  aligner_options.search.enabled = true;
  Plan plan = Tracker::plan(frames.camera, how);
  if (model) plan.format = PixelFormat::rgba8;
  std::shared_ptr<engine::Context> context;
  if (options.solver != Solver::cpu) context = open_device(options.device);
  const auto aligner = make_any_aligner(options.solver, context, plan, aligner_options, model);
  Tracker tracker(*aligner, frames.camera, how);

  TrackReport report;
  report.device = context ? context->info().name : "CPU";
  report.cpu_unasked = context && context->cpu_unasked();
  if (!options.out.empty()) make_output_folder(options.out);
  Growing live(options.out, "live.txt"), lines(options.out, "frames.jsonl");
  live.add("# timestamp tx ty tz qx qy qz qw (camera to world)\n");
  std::vector<TrackedFrame> tracked;
  for (int i = 0; i < frames.size(); ++i) {
    const TrackFrame frame = frames.load(i);
    const auto start = std::chrono::steady_clock::now();
    TrackedFrame t{tracker.track(frame), {}, frames.frame(i).T_wc};
    report.seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const TrackResult& r = t.result;
    report.lost += r.status == TrackStatus::lost;
    report.unconfirmed += r.status != TrackStatus::lost && !r.confirmed;
    report.without_depth += frame.depth.empty();
    report.align_ms += r.align_ms;
    report.keyframe_ms += r.keyframe_ms;
    report.bundle_ms += r.bundle_ms;
    lines.add(frame_json(r));
    if (r.status != TrackStatus::lost) live.add(fmt::format("{:.6f} {}\n", r.time, tum_line(r.T_WC)));
    tracked.push_back(std::move(t));
    progress(i + 1, frames.size(), report.lost);
  }
  report.frames = frames.size();
  report.keyframes = tracker.keyframe_count();
  std::vector<PosePair> live_pairs, adjusted_pairs;
  for (TrackedFrame& t : tracked) {
    if (t.result.status == TrackStatus::lost) continue;
    t.T_WC = tracker.keyframe_pose(t.result.keyframe) * t.result.T_CK.inverse();
    t.T_WC.orthonormalize();
    if (!t.truth) continue;
    live_pairs.push_back({t.result.T_WC, *t.truth});
    adjusted_pairs.push_back({t.T_WC, *t.truth});
  }
  if (live_pairs.size() >= 3) {
    report.live = errors_of(live_pairs);
    report.adjusted = errors_of(adjusted_pairs);
  }
  if (!options.out.empty()) write_results(options, tracker, frames.camera, tracked, report);
  return report;
}

std::string to_text(const TrackReport& r) {
  std::string text = fmt::format("frames     {}: {} tracked, {} of them not confirmed by features, {} lost; {} keyframes\n",
                                 r.frames, r.frames - r.lost, r.unconfirmed, r.lost, r.keyframes);
  if (r.without_depth > 0) text += fmt::format("depth      {} frames have none near in time\n", r.without_depth);
  text += fmt::format("speed      {:.1f} frames/s on {}: alignment {:.1f} ms a frame, new keyframes {:.1f}, bundles {:.1f}\n",
                      r.frames / r.seconds, r.device, r.align_ms / r.frames, r.keyframe_ms / r.frames, r.bundle_ms / r.frames);
  if (!r.live) return text + "truth      none\n";
  for (const auto& [name, e] : {std::pair("live", *r.live), std::pair("adjusted", *r.adjusted)}) {
    text += fmt::format("{:<10} ATE {:.2f} cm (median {:.2f}, max {:.2f}), {:.2f} % of {:.2f} m", name, 100 * e.absolute.rmse,
                        100 * e.absolute.median, 100 * e.absolute.max, 100 * e.absolute.rmse / std::max(e.way, 1e-9), e.way);
    if (e.relative.count > 0)
      text += fmt::format("; RPE over {} frames {:.2f} cm, {:.2f} deg", kRelativeFrames, 100 * e.relative.translation,
                          e.relative.rotation * 180 / M_PI);
    text += "\n";
  }
  return text;
}

}  // namespace iclk
