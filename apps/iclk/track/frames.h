#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/session/io/camera_file.h>
#include <iclk/track/tracker.h>

#include "apps/iclk/io/levels.h"
#include "apps/iclk/io/sequence.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/iclk/io/video.h"
#include "apps/iclk/track/stereo_depth.h"

namespace iclk {

struct FramesOptions {
  std::string folder;  ///< as load_sequence() takes it, or a stereo recording as EuRoC's; or a video file
  /// Instead of the recording's: a folder of depth images, in order one a frame from the first on, as far as they go, or the
  /// depth image of the first frame; of the left camera as it sees, where there are two. Empty: the recording's.
  std::string depth;
  /// Instead of the recording's depth: a folder of feature files, as load_features() reads them, with positions as the (left)
  /// camera sees. Each has the name of its image; in a video, and where none has, they are in order, one a frame from the first
  /// on. Empty: none.
  std::string features;
  /// Images that are 0 where nothing is to be looked at, as the (left) camera sees: one for all frames, or a folder with one a
  /// frame, in order. Empty: nothing is hidden.
  std::string mask;
  std::optional<CameraFile> camera;      ///< none: the folder's camera.txt
  std::optional<Distortion> distortion;  ///< none: the camera file's
  double depth_scale = 0;                ///< 0: the camera file's
  bool depth_along_ray = false;          ///< depths are distances from the camera's centre
  double rate = 30;                      ///< frames a second, where the recording has no times
  int first = 0, count = 0, stride = 1;  ///< frames: from, at most (0: all), every so many
  int depth_every = 1;                   ///< of so many frames that are tracked one has its depth; 0: the first alone
  double depth_holes = 0;                ///< share of every depth image that is taken away, to see what is done without
};

/// A recording's frames, read one at a time, undistorted.
class RecordedFrames {
 public:
  /// Throws what load_sequence(), load_camera() and load_image() throw of the first image, and Error(invalid_argument) where no
  /// frame is chosen or the camera is of another size.
  explicit RecordedFrames(const FramesOptions& options);

  int size() const { return static_cast<int>(chosen_.size()); }
  int doubled() const { return doubled_; }  ///< frames left out: as late as the one before
  const Camera& camera() const { return camera_; }
  const Distortion& distortion() const { return distortion_; }
  /// Of the recording as a whole: a video that is cut off. Empty: none.
  const std::string& problem() const { return problem_; }
  /// Of a stereo recording, whose camera is the rectified left one.
  const std::optional<StereoDepth>& stereo() const { return stereo_; }
  /// Frames have masks: of what the lens did not see, and of what is hidden.
  bool masks() const { return !lens().seen().empty() || !options_.mask.empty(); }
  /// When the camera read what a frame's pixels show; nothing where the frames are as it read them.
  std::optional<RowTimes> rows() const;
  double time(int i) const { return frame(i).stamp; }
  const std::optional<SE3>& truth(int i) const { return frame(i).T_wc; }

  /// A frame's pixels, until the next one is read.
  struct Pixels {
    cv::Mat image;  ///< empty: it cannot be read
    cv::Mat depth;  ///< CV_32FC1 metres, 0 where there is none; empty: none
    std::optional<Features> features;
    cv::Mat mask;         ///< CV_8UC1; empty without masks()
    std::string problem;  ///< what could not be read, and why
    bool has_depth() const { return !depth.empty() || (features && features->size() > 0); }
    void add(const std::string& what) { problem += (problem.empty() ? "" : "; ") + what; }
  };
  const Pixels& read(int i);
  /// Of pixels that have an image.
  TrackFrame view_of(int i) const;

 private:
  const Undistorter& lens() const { return stereo_ ? stereo_->left() : *undistorter_; }
  const SequenceFrame& frame(int i) const { return sequence_.frames[chosen_[static_cast<size_t>(i)]]; }
  void load(const FramesOptions& options);
  void give_depth();
  void list_features();
  void load_masks();
  cv::Mat left_by(const std::string& path) const;
  Features features_of(const std::string& path) const;
  cv::Mat image_of(int i);
  void find_levels();
  void check_size(const cv::Mat& image, const std::string& path) const;
  bool has_depth(int i) const { return options_.depth_every > 0 ? i % options_.depth_every == 0 : i == 0; }

  FramesOptions options_;
  Sequence sequence_;
  std::optional<Video> video_;
  std::string problem_;
  std::vector<size_t> chosen_;
  std::vector<std::string> features_;  // as masks_; empty strings: none
  std::vector<std::string> masks_;     // one a frame of the recording; or empty
  cv::Mat mask_;                       // else: of all frames
  int doubled_ = 0;
  double scale_ = 0;
  Distortion distortion_;
  Camera camera_;
  std::optional<Undistorter> undistorter_;
  std::optional<StereoDepth> stereo_;
  Levels levels_;
  Pixels pixels_;
};

}  // namespace iclk
