#pragma once
#include <functional>
#include <optional>
#include <span>
#include <string>

#include <iclk/session/models.h>
#include <iclk/track/tracker.h>
#include <iclk/track/trajectory.h>

#include "apps/iclk/track/frames.h"

namespace iclk {

struct TrackRunOptions {
  FramesOptions frames;
  Solver solver = Solver::device;
  std::string device;
  std::string model = default_model();  ///< SessionOptions::model
  TrackerOptions tracker;
  int most = 0;        ///< frames, at most; 0: all
  std::string out;     ///< folder; empty: nothing is written
  bool fresh = false;  ///< a run that was stopped there is not continued
  std::string map;     ///< folder `out` of an earlier run, in whose map this one begins; empty: none
};

/// Errors against the recording's truth, of the frames that have one and were not lost.
struct TrackErrors {
  TrajectoryError absolute;
  RelativeError relative;  ///< over 30 frames
  double way = 0;          ///< m
  int frames = 0;
};
TrackErrors track_errors(std::span<const PosePair> poses);

/// What a run counts as it goes on, and a continued one has to know.
struct TrackCounts {
  double seconds = 0;                     ///< in Tracker::track()
  int without_depth = 0, unreadable = 0;  ///< frames without depth; frames, depths or masks that cannot be read
  std::string first_problem;              ///< of those
};

struct TrackReport {
  std::string device;
  bool cpu_unasked = false;
  int frames = 0, continued = 0;  ///< continued: of these, by a run before
  int lost = 0, unconfirmed = 0, keyframes = 0;
  int known_keyframes = 0;  ///< of these, from the map of an earlier run
  int elsewhere = 0;        ///< tracked, but in another map than the one that has most frames
  int doubled = 0;          ///< frames left out
  TrackCounts counts;
  bool readout_sought = false;  ///< by find_readout()
  /// A frame was told its way from another one.
  bool found() const { return frames == 1 ? lost == 0 : frames - lost - elsewhere > 1; }
  double readout_used = 0;                              ///< s: TrackerOptions::readout
  double readout = 0, readout_sigma = 0;                ///< s: what the features say of it
  double align_ms = 0, keyframe_ms = 0, bundle_ms = 0;  ///< sums
  std::optional<TrackErrors> live, adjusted;            ///< as they were answered, and by the keyframes' last poses
};

/// Tracks a recording. With `out`: live.txt (TUM, as answered) and frames.jsonl grow with every frame, and a run that was
/// killed goes on (Journal); trajectory.txt (TUM, by the keyframes' last poses), keyframes.txt, trajectory_kitti.txt, maps.txt,
/// map.ply and path.png are written at the end, whole or not at all. A frame that cannot be read is lost, and said. `progress`:
/// frames done, of how many, lost so far.
TrackReport track_sequence(const TrackRunOptions& options, RecordedFrames& frames,
                           const std::function<void(int, int, int)>& progress);

/// TrackerOptions::readout by the recording's first frames (readout.h). `progress` as above, once a round.
double find_readout(const TrackRunOptions& options, RecordedFrames& frames, const std::function<void(int, int, int)>& progress);

/// The report as lines of text; errors as half a line.
std::string to_text(const TrackReport& report);
std::string to_text(const TrackErrors& errors);

}  // namespace iclk
