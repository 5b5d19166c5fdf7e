#pragma once
#include <cstdint>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

#include <iclk/align/image.h>

#include "apps/iclk/io/image_header.h"

namespace iclk {

/// The default of --set max-pixels: a file of a megabyte may hold 10000x10000 pixels, and a gigabyte of memory.
inline constexpr uint64_t kMaxPixels = uint64_t{8192} * 8192;

/// Once, at the start of a program, before any thread: lets OpenCV read EXR and keeps its own log and its decoders' off the
/// terminal.
void prepare_opencv();

/// An image as its file has it: 1 channel or 3 of 8 or 16 bit (BGR), or of 32-bit float (RGB, taken as they are). Alpha is
/// dropped, an EXIF rotation is not applied (intrinsics belong to the sensor's raster).
/// Throws Error(io) that names the file: missing, empty, not an image, truncated; Error(unsupported) for other pixel types;
/// Error(invalid_argument), before anything is decoded, for one whose header states more than `max_pixels`.
cv::Mat load_image(const std::string& path, uint64_t max_pixels = kMaxPixels);

/// Depth in metres, CV_32FC1, 0 = no depth (also where keep_measured() says so).
/// 16-bit files are divided by `scale` (raw units a metre); float files are metres already and take no scale but 1 (0: none).
/// Throws as load_image does, and Error(invalid_argument) for a wrong type or scale, EXR channels of which it is not plain
/// which is the depth, a PFM whose values are to be scaled, and a file without a single valid pixel.
cv::Mat load_depth(const std::string& path, double scale, uint64_t max_pixels = kMaxPixels);

/// A mask: CV_8UC1, 255 where the file is not 0 (in any of its channels but alpha), else 0. Throws as load_image does.
cv::Mat load_mask(const std::string& path, uint64_t max_pixels = kMaxPixels);

/// The header of a regular file, checked against `max_pixels` as above. Nothing where it cannot be read: load_image() says why,
/// if there is a reason.
std::optional<ImageHeader> peek_image(const std::string& path, uint64_t max_pixels = kMaxPixels);

/// Throws Error(invalid_argument) with both paths and sizes unless the images have the same size.
void require_size(const cv::Mat& image, const std::string& path, const cv::Mat& reference, const std::string& reference_path);

/// The pixels of an image of load_image, not copied. Precondition: `image` outlives the view.
ImageView view(const cv::Mat& image);

/// Grey 8-bit version of an image of load_image, stretched to its range if it is not 8-bit: for pictures and peers.
cv::Mat grey_8bit(const cv::Mat& image);

/// PNG bytes of an 8-bit image.
std::string encode_png(const cv::Mat& image);

}  // namespace iclk
