#include "apps/iclk/track/run.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/version.h"
#include "apps/iclk/track/journal.h"
#include "apps/iclk/track/output.h"
#include "apps/iclk/track/readout.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

constexpr int kRelativeFrames = 30;
constexpr int kReadoutFrames = 100;
constexpr const char* kMapFile = "map.state";

std::string absolute(const std::string& path) { return path.empty() ? path : std::filesystem::absolute(path).string(); }

constexpr std::array<const char*, 3> kSolvers = {"host", "device", "cpu"};  // by Solver

/// The results depend on these. The names are those of the command line.
nlohmann::ordered_json options_of(const TrackRunOptions& options, const RecordedFrames& frames, const TrackerOptions& tracker) {
  const Camera& c = frames.camera();
  const FramesOptions& f = options.frames;
  const DepthSigma& d = tracker.depth_sigma;
  return {{"version", version()},
          {"FOLDER", absolute(f.folder)},
          {"--first", f.first},
          {"--stride", f.stride},
          {"--rate", f.rate},
          {"--camera", {c.fx, c.fy, c.cx, c.cy, c.width, c.height}},
          {"--distortion", distortion_text(frames.distortion())},
          {"--depth", absolute(f.depth)},
          {"--depth-scale", f.depth_scale},
          {"--depth-along-ray", f.depth_along_ray},
          {"--depth-sigma", {d.constant, d.disparity, d.relative}},
          {"--depth-every", f.depth_every},
          {"--set depth-holes", f.depth_holes},
          {"--features", absolute(f.features)},
          {"--mask", absolute(f.mask)},
          {"--map", absolute(options.map)},
          {"--model", options.model},
          {"--solver", kSolvers.at(static_cast<size_t>(options.solver))},
          {"--count", tracker.features},
          {"--seeds", tracker.seeds},
          {"--set keyframes", tracker.keyframes},
          {"--set archive", tracker.archive},
          {"--set window", tracker.window},
          {"--set min-visible", tracker.min_visible},
          {"--readout", tracker.readout}};
}

void start_in_map(const std::string& folder, Tracker& tracker) {
  const std::string path = (std::filesystem::path(folder) / kMapFile).string();
  const std::string bytes = read_file(path);
  try {
    tracker.start_in({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()});
  } catch (const Error& error) {
    throw Error(error.code(), path + ": " + error.what() + "; give the camera and options of the run that wrote it");
  }
}

/// Sets the poses and maps of frames by the keyframes' last ones.
void place(const Tracker& tracker, std::vector<TrackedFrame>& frames) {
  for (TrackedFrame& f : frames) {
    if (f.result.status == TrackStatus::lost) continue;
    f.map = tracker.keyframe_map(f.result.keyframe);
    f.T_WC = tracker.keyframe_pose(f.result.keyframe) * f.result.T_CK.inverse();
    f.T_WC.orthonormalize();
  }
}

/// The map that has most frames.
int largest_map(const std::vector<TrackedFrame>& frames) {
  std::map<int, int> sizes{{0, 0}};
  for (const TrackedFrame& f : frames) sizes[f.map] += f.result.status != TrackStatus::lost;
  return std::max_element(sizes.begin(), sizes.end(), [](const auto& a, const auto& b) { return a.second < b.second; })->first;
}

/// The frames of other maps count as lost from here on. Their number.
int keep_map(int map, std::vector<TrackedFrame>& frames) {
  int others = 0;
  for (TrackedFrame& f : frames) {
    if (f.map == map) continue;
    others += f.result.status != TrackStatus::lost;
    f.result.status = TrackStatus::lost;
    f.result.before.reset();
  }
  return others;
}

void write_results(const TrackRunOptions& options, const Tracker& tracker, const std::vector<TrackedFrame>& frames,
                   const TrackReport& report, const std::string& maps) {
  const auto write = [&](const char* name, const std::string& text) {
    write_file((std::filesystem::path(options.out) / name).string(), text);
  };
  const int map = largest_map(frames);
  std::vector<SE3> poses;
  for (int id = 0; id < tracker.keyframe_count(); ++id)
    if (tracker.keyframe_map(id) == map) poses.push_back(tracker.keyframe_pose(id));
  std::vector<TrackedFrame> keyframes;
  const auto add = [&](int id, double time) {
    TrackedFrame& k = keyframes.emplace_back();
    k.result.status = TrackStatus::keyframe;
    k.result.time = time;
    k.T_WC = tracker.keyframe_pose(id);
  };
  for (const TrackedFrame& f : frames) {
    if (f.result.before) add(f.result.before->keyframe, f.result.before->time);
    if (f.result.status == TrackStatus::keyframe) add(f.result.keyframe, f.result.time);
  }
  write("trajectory.txt", tum_text(frames));
  write("trajectory_kitti.txt", kitti_text(frames));
  write("maps.txt", maps);
  write("keyframes.txt", tum_text(keyframes));
  write("map.ply", map_ply(tracker, map));
  const std::vector<uint8_t> state = tracker.state();
  write(kMapFile, std::string(reinterpret_cast<const char*>(state.data()), state.size()));
  write("path.png", path_png(frames, poses, report.adjusted ? &*report.adjusted : nullptr));
}

}  // namespace

double find_readout(const TrackRunOptions& options, RecordedFrames& frames,
                    const std::function<void(int, int, int)>& progress) {
  TrackRunOptions trial = options;
  trial.out.clear();
  trial.most = kReadoutFrames;
  trial.map.clear();
  return find_readout([&](double readout) {
    trial.tracker.readout = readout;
    const TrackReport r = track_sequence(trial, frames, progress);
    return ReadoutTrial{readout, r.readout, r.readout_sigma, r.frames - r.lost - r.unconfirmed};
  });
}

TrackErrors track_errors(std::span<const PosePair> poses) {
  return {absolute_error(poses), relative_error(poses, kRelativeFrames), way_length(poses), static_cast<int>(poses.size())};
}

TrackReport track_sequence(const TrackRunOptions& options, RecordedFrames& frames,
                           const std::function<void(int, int, int)>& progress) {
  TrackerOptions how = options.tracker;
  how.masks = how.masks || frames.masks();
  how.rows = frames.rows();
  const Session session({.model = options.model, .device = options.device, .solver = options.solver});
  Tracker tracker(session, frames.camera(), how);
  if (!options.map.empty()) start_in_map(options.map, tracker);
  const int known = tracker.keyframe_count();

  TrackReport report;
  report.device = session.context() ? session.device_name() : "CPU";
  report.cpu_unasked = session.cpu_unasked();
  if (!options.out.empty()) make_output_folder(options.out);
  Journal journal(options.out, options_of(options, frames, how), options.fresh, tracker);
  TrackCounts& counts = report.counts = journal.counts();
  std::vector<TrackedFrame> tracked;
  const int count = options.most > 0 ? std::min(options.most, frames.size()) : frames.size();
  report.continued = std::min(count, static_cast<int>(journal.results().size()));
  const auto keep = [&](int i, const TrackResult& r) {
    report.lost += r.status == TrackStatus::lost;
    report.unconfirmed += r.status != TrackStatus::lost && !r.confirmed;
    report.align_ms += r.align_ms;
    report.keyframe_ms += r.keyframe_ms;
    report.bundle_ms += r.bundle_ms;
    tracked.push_back({r, r.map, {}, frames.truth(i)});
  };
  for (int i = 0; i < report.continued; ++i) keep(i, journal.results()[static_cast<size_t>(i)]);
  for (int i = report.continued; i < count; ++i) {
    const auto& pixels = frames.read(i);
    if (!pixels.problem.empty() && counts.unreadable++ == 0) counts.first_problem = pixels.problem;
    counts.without_depth += !pixels.has_depth();
    TrackResult result;
    result.time = frames.time(i);
    result.reason = pixels.problem;
    if (!pixels.image.empty()) {
      const TrackFrame frame = frames.view_of(i);
      const internal::Stopwatch watch;
      result = tracker.track(frame);
      counts.seconds += watch.ms() / 1000;
    }
    keep(i, journal.add(result, counts, tracker));
    progress(i + 1, count, report.lost);
  }
  report.frames = count;
  report.doubled = frames.doubled();
  report.keyframes = tracker.keyframe_count();
  report.known_keyframes = known;
  report.readout_used = how.readout;
  report.readout = tracker.readout().seconds;
  report.readout_sigma = tracker.readout().sigma;
  std::vector<PosePair> live_pairs, adjusted_pairs;
  place(tracker, tracked);
  const std::string maps = maps_text(tracked);
  const int largest = largest_map(tracked);
  report.elsewhere = keep_map(largest, tracked);
  for (const TrackedFrame& t : tracked) {
    if (t.result.status == TrackStatus::lost || !t.truth) continue;
    if (t.result.map == largest) live_pairs.push_back({t.result.T_WC, *t.truth});  // not joined later
    adjusted_pairs.push_back({t.T_WC, *t.truth});
  }
  if (live_pairs.size() >= 3) report.live = track_errors(live_pairs);
  if (adjusted_pairs.size() >= 3) report.adjusted = track_errors(adjusted_pairs);
  if (!options.out.empty()) write_results(options, tracker, tracked, report, maps);
  journal.finish();
  return report;
}

std::string to_text(const TrackReport& r) {
  std::string text = fmt::format("frames     {}: {} tracked, {} of them not confirmed by features, {} lost; {} keyframes\n",
                                 r.frames, r.frames - r.lost, r.unconfirmed, r.lost, r.keyframes);
  if (r.known_keyframes > 0) text += fmt::format("map        {} of the keyframes are from an earlier run\n", r.known_keyframes);
  if (r.continued > 0) text += fmt::format("continued  after {} frames of a run that was stopped\n", r.continued);
  const TrackCounts& c = r.counts;
  if (c.without_depth > 0) text += fmt::format("depth      {} frames have none\n", c.without_depth);
  if (c.unreadable > 0) text += fmt::format("unreadable {}, the first: {}\n", c.unreadable, c.first_problem);
  if (r.doubled > 0) text += fmt::format("left out   {} frames that are not later than the one before\n", r.doubled);
  text +=
      fmt::format("speed      {:.1f} frames/s on {}: ms per frame: alignment {:.1f}, new keyframes {:.1f}, bundles {:.1f}\n",
                  r.frames / c.seconds, r.device, r.align_ms / r.frames, r.keyframe_ms / r.frames, r.bundle_ms / r.frames);
  if (r.elsewhere > 0)
    text += fmt::format("maps       {} of the tracked frames are in other maps, which do not meet the largest one (maps.txt)\n",
                        r.elsewhere);
  if (r.readout_used != 0) text += fmt::format("shutter    rolling, with a readout of {:.1f} ms\n", 1000 * r.readout_used);
  if (r.readout_used == 0 && r.readout_sought) text += "shutter    no readout found: treated as a global shutter\n";
  const double off = std::abs(r.readout - r.readout_used);
  if (off > kLeastReadout && off > kReadoutSigmas * r.readout_sigma)
    text += fmt::format("           the features suggest {:.1f} +- {:.1f} ms{}\n", 1000 * r.readout, 1000 * r.readout_sigma,
                        r.readout_used == 0 && !r.readout_sought ? "; --readout auto estimates it" : "");
  if (!r.adjusted) return text + "truth      none\n";
  for (const auto& [name, e] : {std::pair("live", r.live), std::pair("adjusted", r.adjusted)})
    if (e) text += fmt::format("{:<10} {}\n", name, to_text(*e));
  return text;
}

std::string to_text(const TrackErrors& e) {
  std::string text =
      fmt::format("ATE {:.2f} cm (median {:.2f}, max {:.2f}), {:.2f} % of {:.2f} m", 100 * e.absolute.rmse,
                  100 * e.absolute.median, 100 * e.absolute.max, 100 * e.absolute.rmse / std::max(e.way, 1e-9), e.way);
  if (e.relative.count > 0)
    text += fmt::format("; RPE over {} frames {:.2f} cm, {:.2f} deg", kRelativeFrames, 100 * e.relative.translation,
                        e.relative.rotation / kDegree);
  return text;
}

}  // namespace iclk
