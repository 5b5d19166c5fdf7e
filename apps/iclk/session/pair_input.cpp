#include "apps/iclk/session/pair_input.h"

#include <opencv2/imgproc.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/shaders/shared.h>

#include "apps/iclk/io/levels.h"

namespace iclk {
namespace {

/// What the reference does not show has no depth: its pixels, and features of the file whose patch they are in.
void hide_reference(const cv::Mat& seen, PairInput& pair) {
  if (!pair.depth_0.empty()) pair.depth_0.setTo(0, seen == 0);
  cv::Mat whole;
  cv::erode(seen, whole, cv::Mat::ones(ICLK_PATCH, ICLK_PATCH, CV_8U), {ICLK_PATCH_BEFORE, ICLK_PATCH_BEFORE}, 1,
            cv::BORDER_REPLICATE);
  for (size_t i = 0; i < pair.features.uv.size(); ++i) {
    const Eigen::Vector2d& uv = pair.features.uv[i];
    if (!(uv.x() >= 0 && uv.y() >= 0 && uv.x() < seen.cols && uv.y() < seen.rows)) continue;
    if (whole.at<uchar>(static_cast<int>(uv.y()), static_cast<int>(uv.x())) == 0) pair.features.inverse_depth[i] = 0;
  }
}

}  // namespace

PairLoader::PairLoader(InputOptions options) : options_(std::move(options)) {
  options_.detector.check();
  if (!options_.distortion) options_.distortion = options_.camera.distortion;
  if (options_.depth_scale == 0) options_.depth_scale = options_.camera.depth_scale;
  if (!options_.mask.empty()) mask_ = load_mask(options_.mask, options_.max_pixels);
}

cv::Mat PairLoader::seen(const std::string& own_mask, const cv::Mat& image, const std::string& image_path,
                         const Undistorter* undistort) const {
  cv::Mat seen;
  const auto both = [&](const cv::Mat& mask) { seen = seen.empty() ? mask.clone() : cv::Mat(seen & mask); };
  const auto add = [&](const cv::Mat& mask, const std::string& path) {
    require_size(mask, path, image, image_path);
    // Bilinear, as the image is: a pixel into which a hidden one went is hidden.
    both(undistort != nullptr ? cv::Mat(undistort->image(mask) == 255) : mask);
  };
  if (undistort != nullptr) both(undistort->seen());
  if (!mask_.empty()) add(mask_, options_.mask);
  if (!own_mask.empty()) add(load_mask(own_mask, options_.max_pixels), own_mask);
  return !seen.empty() && cv::countNonZero(seen) < static_cast<int>(seen.total()) ? seen : cv::Mat();
}

std::shared_ptr<const Undistorter> PairLoader::undistorter(const Camera& camera) const {
  const std::lock_guard lock(mutex_);
  if (!cached_ || cached_camera_.width != camera.width || cached_camera_.height != camera.height) {
    cached_ = std::make_shared<Undistorter>(camera, *options_.distortion);
    cached_camera_ = camera;
  }
  return cached_;
}

uint64_t PairLoader::memory(const PairFiles& files, uint64_t budget) const {
  uint64_t sum = 0, largest = 0;
  std::string name;
  for (const std::string* file : {&files.reference, &files.target, &files.depth, &files.reference_mask, &files.target_mask}) {
    const auto header = file->empty() ? std::nullopt : peek_image(*file, options_.max_pixels);
    if (!header) continue;
    ImageHeader decoded = *header;
    if (file == &files.depth) decoded.pixel_bytes = std::max<uint64_t>(decoded.pixel_bytes, sizeof(float));
    sum += decoded.bytes();
    if (decoded.bytes() <= largest) continue;
    largest = decoded.bytes();
    name = *file + " (" + std::to_string(header->width) + "x" + std::to_string(header->height) + ")";
  }
  sum += largest;  // one at a time is there twice: as decoded, and as we want it
  const auto mib = [](uint64_t bytes) { return std::to_string((bytes + (1 << 20) - 1) >> 20); };
  if (sum > budget)
    throw Error(ErrorCode::invalid_argument, name + ": decoding this pair takes " + mib(sum) + " MiB, but --memory is " +
                                                 mib(budget) + " MiB; give --memory " + mib(sum));
  return sum;
}

PairInput PairLoader::load(const PairFiles& files) const {
  const internal::Stopwatch time;
  if (files.depth.empty() && files.features.empty())
    throw Error(ErrorCode::invalid_argument,
                files.reference + ": needs a depth image (--depth) or a feature file (--features)");
  PairInput pair;
  pair.name_0 = files.reference;
  pair.name_1 = files.target;
  pair.image_0 = load_image(files.reference, options_.max_pixels);
  pair.image_1 = load_image(files.target, options_.max_pixels);
  require_size(pair.image_1, files.target, pair.image_0, files.reference);
  const Levels levels{pair.image_0, pair.image_1};
  levels.apply(pair.image_0);
  levels.apply(pair.image_1);
  pair.camera = fit_camera(options_.camera, pair.image_0.cols, pair.image_0.rows);
  if (!files.depth.empty()) {
    pair.depth_0 = load_depth(files.depth, options_.depth_scale, options_.max_pixels);
    require_size(pair.depth_0, files.depth, pair.image_0, files.reference);
  }
  if (!files.features.empty()) {
    pair.features = load_features(files.features);
    pair.features_from_file = true;
  }
  const auto undistort = options_.distortion->empty() ? nullptr : undistorter(pair.camera);
  const cv::Mat seen_0 = seen(files.reference_mask, pair.image_0, files.reference, undistort.get());
  pair.mask_1 = seen(files.target_mask, pair.image_1, files.target, undistort.get());
  if (undistort) {
    pair.image_0 = undistort->image(pair.image_0);
    pair.image_1 = undistort->image(pair.image_1);
    if (!pair.depth_0.empty()) pair.depth_0 = undistort->depth(pair.depth_0);
    for (Eigen::Vector2d& uv : pair.features.uv) uv = undistort->point(uv);
  }
  if (options_.depth_along_ray) {
    along_axis(pair.camera, pair.depth_0);
    along_axis(pair.camera, pair.features);
  }
  if (!seen_0.empty()) hide_reference(seen_0, pair);
  pair.load_ms = time.ms();
  if (files.features.empty()) detect_missing_features(pair, options_.detector, seen_0);
  options_.depth_sigma.apply(pair.camera, pair.features);
  return pair;
}

void detect_missing_features(PairInput& pair, const DetectorOptions& options, const cv::Mat& seen) {
  const internal::Stopwatch time;
  if (pair.features.size() == 0) pair.features = detect_features(view(pair.image_0), view(pair.depth_0), view(seen), options);
  pair.detect_ms = time.ms();
}

}  // namespace iclk
