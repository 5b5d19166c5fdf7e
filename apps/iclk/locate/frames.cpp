#include "apps/iclk/locate/frames.h"

#include <filesystem>
#include <map>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/sequence.h"

namespace iclk {

namespace fs = std::filesystem;

namespace {

/// A file that is a picture as far as its first bytes tell, also one that is damaged.
bool is_picture(const std::string& path) { return peek_image(path) || cv::haveImageReader(path); }

}  // namespace

std::string frame_name(const std::string& image) { return fs::path(image).filename().string(); }

LocateFrames::LocateFrames(const std::vector<std::string>& given) {
  if (given.size() == 1 && fs::exists(fs::path(given[0]) / "rgb.txt")) {
    const Sequence recording = load_sequence(given[0], {.need_depth = false});
    for (const SequenceFrame& f : recording.frames) frames_.push_back({f.image, f.stamp / recording.unit, "", 0, {}});
  } else if (given.size() == 1 && !fs::is_directory(given[0]) && !is_picture(given[0])) {
    video_.emplace(given[0]);
    for (int i = 0; i < video_->size(); ++i) {
      const double time = video_->times().empty() ? i : video_->times()[static_cast<size_t>(i)];
      frames_.push_back({fmt::format("{}#{:06}", given[0], i), time, fmt::format("{:06}.png", i), i, {}});
    }
  } else {
    list_files_of(given);
  }
  std::map<std::string, std::string> paths;
  for (LocateFrame& frame : frames_) {
    const std::string name = frame_name(frame.image);
    if (const auto [other, fresh] = paths.emplace(name, frame.image); !fresh)
      refuse(frame.image + " and " + other->second + " have the same name; locate them in two runs");
    if (frame.overlay.empty()) frame.overlay = fs::path(name).replace_extension(".png").string();
  }
}

void LocateFrames::list_files_of(const std::vector<std::string>& given) {
  for (const std::string& path : given) {
    const bool folder = fs::is_directory(path);
    for (const fs::path& file : folder ? list_files(path) : std::vector<fs::path>{path})
      if (!folder || is_picture(file.string())) frames_.push_back({file.string(), 1.0 * frames_.size(), "", 0, {}});
  }
  if (frames_.empty()) refuse(given[0] + ": has no image");
}

cv::Mat LocateFrames::read(const LocateFrame& frame) { return video_ ? video_->read(frame.index) : load_image(frame.image); }

}  // namespace iclk
