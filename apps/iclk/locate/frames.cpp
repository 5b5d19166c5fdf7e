#include "apps/iclk/locate/frames.h"

#include <filesystem>
#include <map>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/sequence.h"

namespace iclk {

namespace fs = std::filesystem;

std::string frame_name(const std::string& image) { return fs::path(image).filename().string(); }

std::vector<LocateFrame> list_frames(const std::vector<std::string>& given) {
  std::vector<LocateFrame> frames;
  if (given.size() == 1 && fs::exists(fs::path(given[0]) / "rgb.txt")) {
    const Sequence recording = load_sequence(given[0], {.need_depth = false});
    for (const SequenceFrame& f : recording.frames) frames.push_back({f.image, f.stamp / recording.unit, {}});
    return frames;
  }
  for (const std::string& path : given) {
    const std::vector<fs::path> files = fs::is_directory(path) ? list_files(path) : std::vector<fs::path>{path};
    for (const fs::path& file : files)
      if (peek_image(file.string()) || !fs::is_directory(path)) frames.push_back({file.string(), 1.0 * frames.size(), {}});
  }
  if (frames.empty()) refuse(given[0] + ": has no image");
  std::map<std::string, std::string> paths;  // priors and overlays go by the names of files
  for (const LocateFrame& frame : frames)
    if (const auto [other, fresh] = paths.emplace(frame_name(frame.image), frame.image); !fresh)
      refuse(frame.image + " and " + other->second + " have the same name; locate them in two runs");
  return frames;
}

}  // namespace iclk
