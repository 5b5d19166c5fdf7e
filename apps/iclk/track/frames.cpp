#include "apps/iclk/track/frames.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <random>

#include <fmt/format.h>

#include <iclk/engine/error.h>
#include <iclk/session/io/feature_csv.h>

#include "apps/iclk/io/euroc.h"
#include "apps/iclk/io/images.h"

namespace iclk {

namespace {

/// Takes squares away, drawn anew for every frame.
void cut_holes(cv::Mat& depth, double share, int frame) {
  constexpr int kSquare = 64;  // px
  std::mt19937 random(static_cast<uint32_t>(frame));
  for (int v = 0; v < depth.rows; v += kSquare)
    for (int u = 0; u < depth.cols; u += kSquare)
      if (random() < share * 4294967296.0)
        depth(cv::Rect(u, v, std::min(kSquare, depth.cols - u), std::min(kSquare, depth.rows - v))) = 0;
}

}  // namespace

void RecordedFrames::load(const FramesOptions& options) {
  if (std::filesystem::is_regular_file(options.folder)) {
    video_.emplace(options.folder);
    problem_ = video_->problem();
    for (int i = 0; i < video_->size(); ++i)
      sequence_.frames.push_back(
          {video_->times().empty() ? i / options.rate : video_->times()[static_cast<size_t>(i)], options.folder, {}, {}, {}});
    if (options.depth.empty() && options.features.empty())
      throw Error(ErrorCode::invalid_argument, options.folder + " is a video, so it has no depth: give --depth or --features");
  } else if (const auto euroc = euroc_root(options.folder)) {
    sequence_ = load_euroc_sequence(*euroc);
  } else {
    sequence_ =
        load_sequence(options.folder, {.rate = options.rate, .need_depth = options.depth.empty() && options.features.empty()});
  }
}

/// In place of the recording's.
void RecordedFrames::give_depth() {
  if (options_.depth.empty() && options_.features.empty()) return;
  for (SequenceFrame& f : sequence_.frames) f.depth.clear(), f.right.clear();
  if (!options_.features.empty()) return list_features();
  if (!std::filesystem::is_directory(options_.depth)) {
    sequence_.frames[chosen_[0]].depth = options_.depth;
    return;
  }
  const auto files = list_files(options_.depth);
  if (files.empty() || files.size() > sequence_.frames.size())
    throw Error(ErrorCode::invalid_argument,
                fmt::format("{} has {} depth images, but {} has {} frames: give at least one, and at most one per frame",
                            options_.depth, files.size(), options_.folder, sequence_.frames.size()));
  for (size_t i = 0; i < files.size(); ++i) sequence_.frames[i].depth = files[i].string();
}

void RecordedFrames::list_features() {
  const auto files = list_files(options_.features);
  if (files.empty() || files.size() > sequence_.frames.size())
    throw Error(ErrorCode::invalid_argument,
                fmt::format("{} has {} feature files, but {} has {} frames: give at least one, and at most one per frame",
                            options_.features, files.size(), options_.folder, sequence_.frames.size()));
  std::map<std::string, std::string> by_name;
  for (const auto& file : files) by_name[file.stem().string()] = file.string();
  bool named = false;
  for (const SequenceFrame& f : sequence_.frames) {
    const auto at = by_name.find(std::filesystem::path(f.image).stem().string());
    features_.push_back(at == by_name.end() ? "" : at->second);
    named = named || at != by_name.end();
  }
  for (size_t i = 0; i < files.size() && !named; ++i) features_[i] = files[i].string();
}

void RecordedFrames::load_masks() {
  mask_ = lens().seen();
  if (options_.mask.empty()) return;
  if (!std::filesystem::is_directory(options_.mask)) {
    mask_ = left_by(options_.mask);
    return;
  }
  for (const auto& file : list_files(options_.mask)) masks_.push_back(file.string());
  if (masks_.size() != sequence_.frames.size())
    throw Error(ErrorCode::invalid_argument,
                fmt::format("{} has {} masks, but {} has {} frames: give one mask per frame, or one image for all",
                            options_.mask, masks_.size(), options_.folder, sequence_.frames.size()));
}

RecordedFrames::RecordedFrames(const FramesOptions& options) : options_(options) {
  load(options);
  if (!options.camera && !sequence_.camera && !sequence_.rig)
    throw Error(ErrorCode::io, options.folder + (video_ ? " is a video" : " has no camera.txt") + ": give --camera");
  if (sequence_.rig && (options.camera || options.distortion))
    throw Error(ErrorCode::invalid_argument,
                options.folder + " is a stereo recording with sensor.yaml: leave --camera and --distortion out");
  const CameraFile file = options.camera ? *options.camera : sequence_.rig ? sequence_.rig->left : *sequence_.camera;
  scale_ = options.depth_scale > 0 ? options.depth_scale : file.depth_scale;
  distortion_ = options.distortion.value_or(file.distortion);
  const int end = static_cast<int>(sequence_.frames.size());
  for (int i = options.first; i < end && (options.count == 0 || size() < options.count); i += options.stride) {
    const bool later = chosen_.empty() || sequence_.frames[static_cast<size_t>(i)].stamp > frame(size() - 1).stamp;
    if (later)
      chosen_.push_back(static_cast<size_t>(i));
    else
      ++doubled_;
  }
  if (chosen_.empty())
    throw Error(ErrorCode::invalid_argument,
                options.folder + " has " + std::to_string(end) + " frames, but --first is " + std::to_string(options.first));
  give_depth();
  const cv::Mat first = image_of(0);
  if (first.depth() == CV_16U) find_levels();
  if (sequence_.rig && options.depth_along_ray)
    throw Error(ErrorCode::invalid_argument, options.folder + " is a stereo recording: leave --depth-along-ray out");
  if (sequence_.rig) {
    stereo_.emplace(*sequence_.rig, first.cols, first.rows);
    camera_ = stereo_->camera();
    for (SequenceFrame& f : sequence_.frames)
      if (f.T_wc) f.T_wc = *f.T_wc * stereo_->T_left_rectified();
  } else {
    camera_ = fit_camera(file, first.cols, first.rows);
    undistorter_.emplace(camera_, distortion_);
  }
  load_masks();
}

/// By some of the frames, all over the recording.
void RecordedFrames::find_levels() {
  constexpr int kFrames = 16;
  std::vector<cv::Mat> some;
  for (int k = 0; k < kFrames; ++k) {
    try {
      some.push_back(image_of(k * (size() - 1) / (kFrames - 1)));
    } catch (const Error&) {  // read() says so
    }
  }
  levels_ = Levels(some);
}

std::optional<RowTimes> RecordedFrames::rows() const {
  if (lens().seen().empty()) return {};    // nothing is resampled
  const double last = camera_.height - 1;  // the camera's own image is as large
  return RowTimes(camera_,
                  [&](const Eigen::Vector2d& uv) { return row_time(camera_, std::clamp(lens().source(uv).y(), 0.0, last)); });
}

cv::Mat RecordedFrames::image_of(int i) {
  return video_ ? video_->read(static_cast<int>(chosen_[static_cast<size_t>(i)])) : load_image(frame(i).image);
}

void RecordedFrames::check_size(const cv::Mat& image, const std::string& path) const {
  if (image.cols != camera_.width || image.rows != camera_.height)
    throw Error(ErrorCode::invalid_argument, fmt::format("{} has {}x{} pixels, but the first image has {}x{}", path, image.cols,
                                                         image.rows, camera_.width, camera_.height));
}

/// What a mask leaves of what is seen, undistorted as the image is: a pixel into which a hidden one went is hidden.
cv::Mat RecordedFrames::left_by(const std::string& path) const {
  const cv::Mat given = load_mask(path);
  check_size(given, path);
  const cv::Mat mask = lens().image(given) == 255;
  return lens().seen().empty() ? mask : cv::Mat(mask & lens().seen());
}

Features RecordedFrames::features_of(const std::string& path) const {
  Features out = lens().features(load_features(path));
  if (options_.depth_along_ray) along_axis(camera_, out);
  check_features(out, camera_);  // throws
  return out;
}

const RecordedFrames::Pixels& RecordedFrames::read(int i) {
  const SequenceFrame& f = frame(i);
  pixels_ = {};
  const auto attempt = [&](const auto& load, const std::string& path, cv::Mat& to) {
    try {
      cv::Mat loaded = load();
      check_size(loaded, path);
      to = loaded;
    } catch (const Error& error) {
      pixels_.add(error.what());
    }
  };
  attempt([&] { return image_of(i); }, f.image, pixels_.image);
  cv::Mat depth, right;
  if (!f.depth.empty() && has_depth(i)) attempt([&] { return load_depth(f.depth, scale_); }, f.depth, depth);
  if (!f.right.empty() && has_depth(i)) attempt([&] { return load_image(f.right); }, f.right, right);
  if (const std::string path = features_.empty() ? "" : features_[chosen_[static_cast<size_t>(i)]];
      !path.empty() && has_depth(i)) {
    try {
      pixels_.features = features_of(path);
    } catch (const Error& error) {
      pixels_.add(error.what());
    }
  }
  pixels_.mask = mask_;
  if (!masks_.empty()) {
    const std::string& path = masks_[chosen_[static_cast<size_t>(i)]];
    attempt([&] { return left_by(path); }, path, pixels_.mask);
    if (pixels_.mask.empty()) pixels_.image.release();  // what is hidden would be looked at
  }
  levels_.apply(pixels_.image);
  levels_.apply(right);
  if (!pixels_.image.empty()) pixels_.image = lens().image(pixels_.image);
  if (!depth.empty()) pixels_.depth = lens().depth(depth);
  if (options_.depth_along_ray) along_axis(camera_, pixels_.depth);
  if (!right.empty() && !pixels_.image.empty()) pixels_.depth = stereo_->depth(pixels_.image, right);
  if (!pixels_.depth.empty()) cut_holes(pixels_.depth, options_.depth_holes, i);
  return pixels_;
}

TrackFrame RecordedFrames::view_of(int i) const {
  TrackFrame out{.time = time(i), .image = view(pixels_.image), .depth = {}, .mask = {}};
  if (!pixels_.depth.empty()) out.depth = view(pixels_.depth);
  if (masks()) out.mask = view(pixels_.mask);
  if (pixels_.features) out.features = &*pixels_.features;
  return out;
}

}  // namespace iclk
