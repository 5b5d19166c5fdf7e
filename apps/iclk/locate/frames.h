#pragma once
#include <string>
#include <vector>

#include <iclk/locate/locator.h>

namespace iclk {

/// A picture that is to be located.
struct LocateFrame {
  std::string image;  ///< path; its file name is that of no other frame
  double time = 0;    ///< s; of pictures without times their number
  LocatePrior prior;
};

/// The name by which priors, pixels and overlays find a frame: that of its file.
std::string frame_name(const std::string& image);

/// The pictures of files, folders of images, or one recording with rgb.txt, without priors. Throws Error(io), and
/// Error(invalid_argument) if there is none or two have one name.
std::vector<LocateFrame> list_frames(const std::vector<std::string>& given);

}  // namespace iclk
