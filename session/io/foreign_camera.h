#pragma once
#include <string>
#include <string_view>

#include <iclk/session/io/camera_file.h>

namespace iclk {

/// Reads a COLMAP cameras.txt with one camera, or several equal ones: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV,
/// OPENCV_FISHEYE, FULL_OPENCV. Returns false if the text has another format. Throws Error(invalid_argument) that begins with
/// `file.source`.
bool read_colmap(std::string_view text, CameraFile& file);

/// The name of a known camera format that iclk does not read; empty: unknown.
std::string foreign_format(std::string_view text);

}  // namespace iclk
