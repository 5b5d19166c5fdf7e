#pragma once
#include <string>
#include <string_view>

#include <iclk/session/io/camera_file.h>

namespace iclk {

/// A COLMAP cameras.txt with one camera, or several that are the same: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV,
/// OPENCV_FISHEYE, FULL_OPENCV. False where the text is none. Throws Error(invalid_argument) that begins with `file.source`.
bool read_colmap(std::string_view text, CameraFile& file);

/// The name of a format of cameras that iclk does not read; empty where it knows none.
std::string foreign_format(std::string_view text);

}  // namespace iclk
