#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace iclk {

/// What an image file says of itself, before anything is decoded.
struct ImageHeader {
  uint64_t width = 0, height = 0;
  uint64_t pixel_bytes = 0;  ///< of a decoded pixel, at most

  bool exceeds(uint64_t pixels) const { return width != 0 && height > pixels / width; }
  /// Precondition: some limit is not exceeded; sides may be up to 2^32.
  uint64_t bytes() const { return width * height * pixel_bytes; }
};

/// Of PNG, JPEG, OpenEXR, PNM, PAM, PFM, Radiance and Sun files, from their first bytes. Nothing: another format, or what is
/// there of the file does not say.
std::optional<ImageHeader> image_header(std::string_view bytes);

/// Whether a JPEG file ends before its image does, for which libjpeg puts grey and calls it success. What follows the image
/// (the film of a motion photo) does not matter.
bool is_truncated_jpeg(std::string_view bytes);

/// The same of a PNG cut after its last whole row: the end chunk is what says that it is complete.
bool is_truncated_png(std::string_view bytes);

/// "A,B,G,R": the channels of an OpenEXR file. Empty: another format, or the file does not say.
std::string exr_channels(std::string_view bytes);

/// The size of the scale in a PFM's header; 1 for other formats.
double pfm_scale(std::string_view bytes);

}  // namespace iclk
