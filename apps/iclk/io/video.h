#pragma once
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

namespace cv {
class VideoCapture;
}

namespace iclk {

/// A video file, frame by frame in its order. One frame is held at a time.
class Video {
 public:
  /// Goes through the file once, for its frames' times; so that what cannot be decoded is known before any work. Throws
  /// Error(io) that names the file: missing, empty, no video, a codec that OpenCV lacks, or not a single frame;
  /// Error(invalid_argument) for frames of more than kMaxPixels.
  explicit Video(const std::string& path);
  ~Video();
  Video(Video&&) noexcept;

  int size() const { return static_cast<int>(times_.size()); }
  /// s, of the container; empty where they do not increase from frame to frame, as in containers without any.
  const std::vector<double>& times() const { return times_increase_ ? times_ : none_; }
  /// What the container promises and the file does not hold; empty: nothing.
  const std::string& problem() const { return problem_; }

  /// CV_8UC3 or CV_8UC1, of the file's raster: not turned upright, since the intrinsics belong to it. The next frame costs its
  /// decoding, a later one that of all between, an earlier one that of all before. Throws Error(io).
  cv::Mat read(int i);

 private:
  void open();

  std::string path_, problem_;
  std::vector<double> times_, none_;
  bool times_increase_ = true;
  std::unique_ptr<cv::VideoCapture> capture_;
  int next_ = 0;
};

}  // namespace iclk
