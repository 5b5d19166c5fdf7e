// Follows the camera of a recording with depth, one frame at a time, as a program with a live camera would:
//   example_track_video colour.avi depths FX FY CX CY path.avi
// depths has one 16-bit PNG in millimetres for each frame, in the order of their names. The frames come at the camera's pace.
// A frame that comes while the one before is tracked is dropped. path.avi shows each frame with its status, and the way.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <set>
#include <thread>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include <iclk/iclk.h>
#include <iclk/track/tracker.h>

using Clock = std::chrono::steady_clock;

/// The frame at the left, the way seen from above at the right.
cv::Mat drawn(const cv::Mat& image, const iclk::TrackResult& result, std::vector<cv::Point2d>& way) {
  cv::Mat picture(image.rows, image.cols + image.rows, CV_8UC3, cv::Scalar::all(255));
  image.copyTo(picture(cv::Rect(0, 0, image.cols, image.rows)));
  const bool lost = result.status == iclk::TrackStatus::lost;
  cv::putText(picture, iclk::name(result.status), {10, 30}, cv::FONT_HERSHEY_SIMPLEX, 0.8,
              lost ? cv::Scalar(0, 0, 255) : cv::Scalar(0, 160, 0), 2);
  if (!lost) way.emplace_back(result.T_WC.t.x(), -result.T_WC.t.z());
  double reach = 0.5;  // m
  for (const cv::Point2d& p : way) reach = std::max({reach, std::abs(p.x), std::abs(p.y)});
  for (const cv::Point2d& p : way)
    cv::circle(picture,
               cv::Point(cv::Point2d(image.cols + image.rows / 2.0, image.rows / 2.0) + p * (0.45 * image.rows / reach)), 2,
               {160, 80, 0}, cv::FILLED);
  return picture;
}

int main(int count, char** words) try {
  if (count != 8) return std::fputs("COLOUR.avi DEPTHS FX FY CX CY PATH.avi\n", stderr), 2;
  cv::VideoCapture video(words[1]);
  std::set<std::filesystem::path> depths;
  for (const auto& entry : std::filesystem::directory_iterator(words[2])) depths.insert(entry.path());
  const double rate = video.get(cv::CAP_PROP_FPS);
  cv::Mat image;
  if (!video.read(image) || !(rate > 0)) return std::fprintf(stderr, "%s is no video\n", words[1]), 2;
  const iclk::Camera camera{std::stod(words[3]), std::stod(words[4]), std::stod(words[5]),
                            std::stod(words[6]), image.cols,          image.rows};
  iclk::Tracker tracker(iclk::Session(), camera);
  cv::VideoWriter out(words[7], cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), rate, {image.cols + image.rows, image.rows});

  std::vector<cv::Point2d> way;
  auto start = Clock::now();
  int number = 0, dropped = 0;
  for (auto depth = depths.begin(); depth != depths.end(); ++depth, ++number) {
    const auto due = start + std::chrono::duration<double>(number / rate);
    if (number > 0 && !video.read(image)) break;
    if (Clock::now() > due + std::chrono::duration<double>(1 / rate)) {
      ++dropped;
      continue;
    }
    std::this_thread::sleep_until(due);
    cv::Mat metres;
    cv::imread(depth->string(), cv::IMREAD_UNCHANGED).convertTo(metres, CV_32F, 0.001);
    iclk::TrackFrame frame;
    frame.time = number / rate;
    frame.image = {image.data, image.cols, image.rows, image.step, iclk::PixelFormat::bgr8};
    frame.depth = {metres.data, metres.cols, metres.rows, metres.step, iclk::PixelFormat::r32f};
    const iclk::TrackResult result = tracker.track(frame);
    if (number == 0) start = Clock::now();  // kernels are made for the first frame
    out.write(drawn(image, result, way));
  }
  std::printf("%d frames, %d dropped, %zu with a pose\n", number, dropped, way.size());
} catch (const std::exception& e) {
  return std::fprintf(stderr, "%s\n", e.what()), 2;
}
