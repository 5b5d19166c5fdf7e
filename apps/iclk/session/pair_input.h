#pragma once
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/session/depth_sigma.h>
#include <iclk/session/detect.h>
#include <iclk/session/io/camera_file.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/io/undistorter.h"
#include "apps/json/pair_files.h"

namespace iclk {

/// How files become a pair.
struct InputOptions {
  CameraFile camera;
  std::optional<Distortion> distortion;  ///< in place of the camera file's
  double depth_scale = 0;                ///< raw units a metre; 0: the camera file's
  DepthSigma depth_sigma;
  bool depth_along_ray = false;  ///< depths, also those of features, are distances from the camera's centre
  std::string mask;              ///< image that hides pixels of both images where it is 0; may be empty
  DetectorOptions detector;
  uint64_t max_pixels = kMaxPixels;  ///< of an image or a depth image
};

/// A pair in memory, as a pinhole camera would have seen it. All pixel coordinates are of the undistorted images.
struct PairInput {
  std::string name_0, name_1;  ///< for messages and pictures
  cv::Mat image_0, image_1;    ///< as load_image gives them, of one size
  cv::Mat depth_0;             ///< CV_32FC1 metres, 0 = none; empty: only the features have depth
  cv::Mat mask_1;              ///< CV_8UC1, 0 = hidden; empty: nothing is
  Camera camera;
  Features features;
  std::optional<SE3> T_10;   ///< first guess, if somebody gave one
  std::optional<SE3> truth;  ///< T_10
  bool features_from_file = false;
  double load_ms = 0, detect_ms = 0;

  SE3 start() const { return T_10.value_or(SE3()); }  ///< where ICLK begins without a search
};

/// Loads pairs of one camera. Thread-safe: a pool of threads may share it.
class PairLoader {
 public:
  /// Throws as load_mask does for InputOptions::mask.
  explicit PairLoader(InputOptions options);

  /// Throws Error that names the file: missing, unreadable, of another size, without depth, ...
  PairInput load(const PairFiles& files) const;
  /// What load() takes while it decodes, bytes, as the files' headers say; 0 where they do not. Throws Error(invalid_argument)
  /// that names the file for more pixels than allowed, and for more than `budget` bytes.
  uint64_t memory(const PairFiles& files, uint64_t budget) const;
  /// With what holds where nothing else was said: the camera file's distortion and depth scale.
  const InputOptions& options() const { return options_; }

 private:
  std::shared_ptr<const Undistorter> undistorter(const Camera& camera) const;

  /// What of an image is to be seen, undistorted: CV_8UC1, 0 = hidden; empty: all of it.
  cv::Mat seen(const std::string& own_mask, const cv::Mat& image, const std::string& image_path,
               const Undistorter* undistort) const;

  InputOptions options_;
  cv::Mat mask_;
  mutable std::mutex mutex_;
  mutable Camera cached_camera_;
  mutable std::shared_ptr<const Undistorter> cached_;  // its maps take longer to make than an image to load
};

/// A pair that is not in files (scenes, sequences in memory): detects features where there are none. Throws as PairLoader does.
void detect_missing_features(PairInput& pair, const DetectorOptions& options, const cv::Mat& seen = {});

}  // namespace iclk
