#include "apps/iclk/io/images.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>

#include <cpl_error.h>
#include <cpl_vsi.h>
#include <gdal.h>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/depth_values.h>
#include <iclk/session/internal/grey.h>
#include <iclk/session/io/text.h>

#include "apps/json/format.h"

namespace iclk {
namespace {

/// What GDAL says goes nowhere. It has told libtiff to speak through it, when OpenCV asks too.
class QuietGdal {
 public:
  QuietGdal() { CPLPushErrorHandler(CPLQuietErrorHandler); }
  ~QuietGdal() { CPLPopErrorHandler(); }
  QuietGdal(const QuietGdal&) = delete;
  QuietGdal& operator=(const QuietGdal&) = delete;
};

/// TIFF, BMP, WebP and JPEG 2000, by the readers of GDAL, which are OpenCV's libraries for the most part. No other formats:
/// some of GDAL's name further files to open.
std::optional<ImageHeader> gdal_header(const std::string& path) {
  static const bool registered = (GDALAllRegister(), true);
  static_cast<void>(registered);
  const char* const formats[] = {"GTiff", "BMP", "WEBP", "JP2OpenJPEG", nullptr};
  const char* const no_siblings[] = {nullptr};
  const QuietGdal quiet;
  std::optional<ImageHeader> header;
  if (const GDALDatasetH file = GDALOpenEx(path.c_str(), GDAL_OF_RASTER, formats, nullptr, no_siblings)) {
    if (const int bands = GDALGetRasterCount(file); bands > 0) {
      const GDALDataType type = GDALGetRasterDataType(GDALGetRasterBand(file, 1));
      // 16 bit with a sign may be LogLuv, which becomes float.
      const int bytes = type == GDT_Int16 ? 4 : GDALGetDataTypeSizeBytes(type);
      header = {static_cast<uint64_t>(GDALGetRasterXSize(file)), static_cast<uint64_t>(GDALGetRasterYSize(file)),
                static_cast<uint64_t>(std::min(bands, 4) * bytes)};
    }
    GDALClose(file);
  }
  return header;
}

std::optional<ImageHeader> header_of(const std::string& bytes) {
  if (const auto header = image_header(bytes)) return header;
  static std::atomic<int> count = 0;
  const std::string name = "/vsimem/iclk_image_" + std::to_string(++count);
  auto* const data = reinterpret_cast<GByte*>(const_cast<char*>(bytes.data()));
  VSILFILE* const file = VSIFileFromMemBuffer(name.c_str(), data, bytes.size(), FALSE);
  if (file == nullptr) return {};
  VSIFCloseL(file);
  const auto header = gdal_header(name);
  VSIUnlink(name.c_str());
  return header;
}

void check_size(const std::string& path, const ImageHeader& header, uint64_t max_pixels) {
  if (!header.exceeds(max_pixels)) return;
  throw Error(ErrorCode::invalid_argument, path + " is " + std::to_string(header.width) + "x" + std::to_string(header.height) +
                                               ", but --set max-pixels allows " + std::to_string(max_pixels) +
                                               " pixels; set it higher if the image is meant to be this large");
}

cv::Mat decode(const std::string& path, const std::string& bytes, uint64_t max_pixels) {
  if (bytes.empty()) throw Error(ErrorCode::io, "cannot read " + path + ": the file is empty");
  cv::Mat image;
  std::string why = "damaged, or in a format that OpenCV cannot read";
  if (is_truncated_jpeg(bytes) || is_truncated_png(bytes)) {
    why = "the file is truncated";
  } else if (const auto header = header_of(bytes)) {
    check_size(path, *header, max_pixels);
    const QuietGdal quiet;
    try {
      const cv::Mat raw(1, static_cast<int>(bytes.size()), CV_8U, const_cast<char*>(bytes.data()));
      image = cv::imdecode(raw, cv::IMREAD_UNCHANGED);
    } catch (const cv::Exception& e) {
      why += " (" + printable(e.err) + ")";
    } catch (const std::bad_alloc&) {
      why = "not enough memory for its pixels";
    }
  }
  if (image.empty()) throw Error(ErrorCode::io, "cannot read " + path + ": " + why);
  return image;
}

std::string units_text(double x) { return formatted("%g", x); }

std::string type_name(const cv::Mat& image) {
  static const char* depths[] = {"8-bit",          "signed 8-bit", "16-bit",      "signed 16-bit",
                                 "32-bit integer", "32-bit float", "64-bit float"};
  const int d = image.depth();
  return (d <= CV_64F ? depths[d] : "16-bit float") + std::string(" with ") + std::to_string(image.channels()) + " channel" +
         (image.channels() == 1 ? "" : "s");
}

}  // namespace

void prepare_opencv() {
  setenv("OPENCV_IO_ENABLE_OPENEXR", "1", 1);
  setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
}

std::optional<ImageHeader> peek_image(const std::string& path, uint64_t max_pixels) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) return {};
  std::string begin(size_t{1} << 20, '\0');  // a camera's JPEG has its size behind colour profiles and thumbnails
  std::ifstream in(path, std::ios::binary);
  in.read(begin.data(), static_cast<std::streamsize>(begin.size()));
  begin.resize(static_cast<size_t>(std::max<std::streamsize>(in.gcount(), 0)));
  auto header = image_header(begin);
  if (!header && !begin.empty()) header = gdal_header(path);
  if (header) check_size(path, *header, max_pixels);
  return header;
}

cv::Mat load_image(const std::string& path, uint64_t max_pixels) {
  cv::Mat image = decode(path, read_file(path), max_pixels);
  if (image.depth() == CV_64F) image.convertTo(image, CV_32F);
  if (image.depth() != CV_8U && image.depth() != CV_16U && image.depth() != CV_32F)
    throw Error(ErrorCode::unsupported, path + " is " + type_name(image) + "; 8-bit, 16-bit or 32-bit float is needed");
  if (image.channels() == 4) {
    cv::cvtColor(image, image, cv::COLOR_BGRA2BGR);
  } else if (image.channels() == 2) {
    cv::extractChannel(image, image, 0);
  } else if (image.channels() != 1 && image.channels() != 3) {
    throw Error(ErrorCode::unsupported, path + " is " + type_name(image) + "; grey or colour is needed");
  }
  if (image.depth() == CV_32F && !cv::checkRange(image))
    throw Error(ErrorCode::invalid_argument, path + " has NaN or infinite pixels; replace them, and hide them with --mask");
  if (image.type() == CV_32FC3) cv::cvtColor(image, image, cv::COLOR_BGR2RGB);  // the library knows rgb32f, not bgr32f
  return image;
}

cv::Mat load_mask(const std::string& path, uint64_t max_pixels) {
  std::vector<cv::Mat> planes;
  cv::split(load_image(path, max_pixels), planes);
  cv::Mat mask = planes[0] != 0;
  for (size_t i = 1; i < planes.size(); ++i) mask |= planes[i] != 0;
  return mask;
}

cv::Mat load_depth(const std::string& path, double scale, uint64_t max_pixels) {
  const std::string bytes = read_file(path);
  if (const std::string names = exr_channels(bytes); !names.empty() && names != "Y" && names != "B,G,R" && names != "A,B,G,R")
    throw Error(ErrorCode::invalid_argument,
                path + " has the EXR channels " + printable(names) + "; write a file with the depth alone, as channel Y");
  cv::Mat raw = decode(path, bytes, max_pixels), depth;
  const std::string remedy = "; a depth image is 16-bit with --depth-scale, or 32-bit float in metres, with 1 channel";
  if (raw.channels() > 1 && raw.depth() >= CV_32F) {
    // EXR writers repeat a single channel as grey colour.
    std::vector<cv::Mat> planes;
    cv::split(raw, planes);
    if (raw.channels() == 3 && cv::norm(planes[0], planes[1], cv::NORM_INF) == 0 &&
        cv::norm(planes[0], planes[2], cv::NORM_INF) == 0)
      raw = planes[0];
  }
  if (const double factor = pfm_scale(bytes); factor != 1)
    throw Error(ErrorCode::invalid_argument,
                path + " is a PFM with the scale " + std::to_string(factor) +
                    ", which writers do not interpret in the same way; write it with the scale 1 or -1");
  if (raw.channels() != 1) throw Error(ErrorCode::invalid_argument, path + " is " + type_name(raw) + remedy);
  if (raw.depth() == CV_16U) {
    if (!(std::isfinite(scale) && scale > 0))
      throw Error(ErrorCode::invalid_argument,
                  path + " is 16-bit: give the raw units per metre as --depth-scale (TUM RGB-D: 5000, millimetres: 1000)");
    raw.convertTo(depth, CV_32F, 1 / scale);
  } else if (raw.depth() == CV_32F || raw.depth() == CV_64F) {
    if (scale != 0 && scale != 1)
      throw Error(ErrorCode::invalid_argument,
                  path + " is float, so its values are metres, but the depth scale is " + units_text(scale) +
                      " units per metre; leave it out, or give --depth-scale 1, if they are metres");
    raw.convertTo(depth, CV_32F);
  } else {
    throw Error(ErrorCode::invalid_argument, path + " is " + type_name(raw) + remedy);
  }
  const double saturated = raw.depth() == CV_16U ? 65534.5 / scale : std::numeric_limits<double>::infinity();
  if (keep_measured({depth.ptr<float>(), depth.total()}, saturated) == 0)
    throw Error(ErrorCode::invalid_argument,
                path + " has no depth (all pixels are 0, negative or not finite); give the depth image of the reference");
  return depth;
}

void require_size(const cv::Mat& image, const std::string& path, const cv::Mat& reference, const std::string& reference_path) {
  if (image.size() == reference.size()) return;
  const auto text = [](const cv::Mat& m) { return std::to_string(m.cols) + "x" + std::to_string(m.rows); };
  throw Error(ErrorCode::invalid_argument, path + " is " + text(image) + " but " + reference_path + " is " + text(reference) +
                                               ": they must have the same size");
}

ImageView view(const cv::Mat& image) {
  PixelFormat format = PixelFormat::r8;
  switch (image.type()) {
    case CV_8UC1: break;
    case CV_8UC3: format = PixelFormat::bgr8; break;
    case CV_16UC1: format = PixelFormat::r16; break;
    case CV_16UC3: format = PixelFormat::bgr16; break;
    case CV_32FC1: format = PixelFormat::r32f; break;
    case CV_32FC3: format = PixelFormat::rgb32f; break;
    default: throw Error(ErrorCode::unsupported, "no pixel format for an image that is " + type_name(image));
  }
  return {image.data, image.cols, image.rows, image.step[0], format};
}

cv::Mat grey_8bit(const cv::Mat& image) {
  const std::vector<uint8_t> grey = grey_8bit(view(image));
  return cv::Mat(grey, true).reshape(1, image.rows);
}

std::string encode_png(const cv::Mat& image) {
  std::vector<uchar> bytes;
  if (!cv::imencode(".png", image, bytes)) throw Error(ErrorCode::unsupported, "OpenCV cannot encode this image as PNG");
  return {bytes.begin(), bytes.end()};
}

}  // namespace iclk
