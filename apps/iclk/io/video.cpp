#include "apps/iclk/io/video.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iterator>

#include <opencv2/videoio.hpp>

#include <iclk/engine/error.h>

#include "apps/iclk/io/images.h"
#include "apps/json/format.h"

namespace iclk {

void Video::open() {
  capture_ = std::make_unique<cv::VideoCapture>();
  // Those that read files: OpenCV would go on to ask the cameras that are plugged in.
  constexpr cv::VideoCaptureAPIs files[] = {cv::CAP_FFMPEG, cv::CAP_GSTREAMER, cv::CAP_OPENCV_MJPEG};
  if (std::none_of(std::begin(files), std::end(files), [&](int reader) { return capture_->open(path_, reader); }))
    throw Error(ErrorCode::io, path_ + ": cannot be read as a video: damaged, truncated, or in a codec that this OpenCV lacks");
  capture_->set(cv::CAP_PROP_ORIENTATION_AUTO, 0);
  next_ = 0;
}

Video::Video(const std::string& path) : path_(path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) throw Error(ErrorCode::io, path + ": no such file");
  if (std::filesystem::file_size(path, error) == 0) throw Error(ErrorCode::io, path + ": the file is empty");
  open();
  const double width = capture_->get(cv::CAP_PROP_FRAME_WIDTH), height = capture_->get(cv::CAP_PROP_FRAME_HEIGHT);
  if (width * height > static_cast<double>(kMaxPixels))
    throw Error(ErrorCode::invalid_argument,
                formatted("%s: frames of %.0fx%.0f pixels are too large", path.c_str(), width, height));
  const double promised = capture_->get(cv::CAP_PROP_FRAME_COUNT);
  while (capture_->grab()) {
    const double time = capture_->get(cv::CAP_PROP_POS_MSEC) / 1000;
    if (!std::isfinite(time) || (!times_.empty() && !(time > times_.back()))) times_increase_ = false;
    times_.push_back(time);
  }
  if (times_.empty()) throw Error(ErrorCode::io, path + ": no frame can be decoded");
  if (promised > size() + 1)
    problem_ = formatted("%s ends after %d of its %.0f frames; it may be truncated", path.c_str(), size(), promised);
  open();
}

Video::~Video() = default;
Video::Video(Video&&) noexcept = default;

cv::Mat Video::read(int i) {
  if (i < next_) open();
  cv::Mat image;
  bool good = true;
  for (; good && next_ < i; ++next_) good = capture_->grab();
  if (good) good = capture_->read(image) && !image.empty();
  ++next_;
  if (!good || (image.type() != CV_8UC3 && image.type() != CV_8UC1))
    throw Error(ErrorCode::io, formatted("%s: frame %d cannot be decoded", path_.c_str(), i));
  return image;
}

}  // namespace iclk
