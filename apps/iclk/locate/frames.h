#pragma once
#include <optional>
#include <string>
#include <vector>

#include <iclk/locate/locator.h>

#include "apps/iclk/io/video.h"

namespace iclk {

/// A picture that is to be located.
struct LocateFrame {
  std::string image;    ///< path; its file name is that of no other frame. Of a video "video.mp4#000123"
  double time = 0;      ///< s; of pictures without times their number
  std::string overlay;  ///< the name of its overlay's file
  int index = 0;        ///< in the video
  LocatePrior prior;
  bool follows = false;  ///< in a sequence: it has no prior of its own, only that of a frame before
};

/// The name by which priors, pixels and lines find a frame: that of its file.
std::string frame_name(const std::string& image);

/// The pictures of files, folders of images, one recording with rgb.txt, or one video; without priors.
class LocateFrames {
 public:
  /// Throws Error(io), the errors of Video, and Error(invalid_argument) if there is no picture or two have one name.
  explicit LocateFrames(const std::vector<std::string>& given);

  const std::vector<LocateFrame>& all() const { return frames_; }
  bool is_video() const { return video_.has_value(); }
  /// What of a video is missing; empty: nothing.
  std::string problem() const { return video_ ? video_->problem() : ""; }
  /// The pixels. Throws the errors of load_image() and Video::read().
  cv::Mat read(const LocateFrame& frame);

 private:
  void list_files_of(const std::vector<std::string>& given);

  std::vector<LocateFrame> frames_;
  std::optional<Video> video_;
};

}  // namespace iclk
