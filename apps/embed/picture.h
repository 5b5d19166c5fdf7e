#pragma once
#include <string>

#include "apps/embed/resources.h"

namespace embed {

/// Writes two images of one size side by side as PNG. Waits for the device. Throws iclk::Error(io).
void write_picture(Host& host, const Image& left, const Image& right, const std::string& path);

}  // namespace embed
