#include "apps/pair_input.h"

#include <chrono>

#include <iclk/engine/error.h>

#include "apps/io/feature_csv.h"

namespace iclk {
namespace {

double ms_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

std::string size_of(const cv::Mat& image) { return std::to_string(image.cols) + "x" + std::to_string(image.rows); }

void require_size(const cv::Mat& image, const std::string& path, const cv::Mat& reference, const std::string& reference_path) {
  if (image.size() == reference.size()) return;
  throw Error(ErrorCode::invalid_argument, path + " is " + size_of(image) + " but " + reference_path + " is " +
                                               size_of(reference) + ": they must have one size");
}

}  // namespace

PairLoader::PairLoader(InputOptions options) : options_(std::move(options)) {
  options_.detector.check();
  if (!options_.distortion) options_.distortion = options_.camera.distortion;
  if (options_.depth_scale == 0) options_.depth_scale = options_.camera.depth_scale;
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
  for (const std::string* file : {&files.reference, &files.target, &files.depth}) {
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
    throw Error(ErrorCode::invalid_argument, name + ": to decode this pair takes " + mib(sum) + " MiB, more than the " +
                                                 mib(budget) + " of --memory; give --memory " + mib(sum));
  return sum;
}

PairInput PairLoader::load(const PairFiles& files) const {
  const auto start = std::chrono::steady_clock::now();
  if (files.depth.empty() && files.features.empty())
    throw Error(ErrorCode::invalid_argument,
                files.reference + ": a depth image (--depth) or a feature file (--features) is needed");
  PairInput pair;
  pair.name_0 = files.reference;
  pair.name_1 = files.target;
  pair.image_0 = load_image(files.reference, options_.max_pixels);
  pair.image_1 = load_image(files.target, options_.max_pixels);
  require_size(pair.image_1, files.target, pair.image_0, files.reference);
  pair.camera = fit_camera(options_.camera, pair.image_0.cols, pair.image_0.rows);
  if (!files.depth.empty()) {
    pair.depth_0 = load_depth(files.depth, options_.depth_scale, options_.max_pixels);
    require_size(pair.depth_0, files.depth, pair.image_0, files.reference);
  }
  if (!files.features.empty()) {
    pair.features = load_features(files.features);
    pair.features_from_file = true;
  }
  cv::Mat seen;
  if (!options_.distortion->empty()) {
    const auto undistort = undistorter(pair.camera);
    pair.image_0 = undistort->image(pair.image_0);
    pair.image_1 = undistort->image(pair.image_1);
    if (!pair.depth_0.empty()) pair.depth_0 = undistort->depth(pair.depth_0);
    for (Eigen::Vector2d& uv : pair.features.uv) uv = undistort->point(uv);
    seen = undistort->seen();
  }
  pair.load_ms = ms_since(start);
  if (files.features.empty()) detect_missing_features(pair, options_.detector, seen);
  options_.depth_sigma.apply(pair.camera, pair.features);
  return pair;
}

void detect_missing_features(PairInput& pair, const DetectorOptions& options, const cv::Mat& seen) {
  const auto start = std::chrono::steady_clock::now();
  if (pair.features.size() == 0) pair.features = detect_features(pair.image_0, pair.depth_0, seen, options);
  pair.detect_ms = ms_since(start);
}

}  // namespace iclk
