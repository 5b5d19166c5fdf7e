#pragma once
#include <string>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>

namespace iclk {

/// The sigma of inverse depths from structured light, 1/m: a Kinect's depth error is 0.0014 z^2 (Khoshelham and Oude Elberink
/// 2012). It is the default of trackers.
inline constexpr double kStructuredLightSigma = 0.0014;

/// The depth error of a sensor: the standard deviation of the inverse depth q is constant + disparity / |fx| + relative q.
/// All zero: unknown.
struct DepthSigma {
  double constant = 0;   ///< 1/m; for stereo and structured light, whose depth errors grow with the square of the depth
  double disparity = 0;  ///< px / m, for stereo: the sigma of the disparity divided by the baseline
  double relative = 0;   ///< share of q

  bool said() const { return constant > 0 || disparity > 0 || relative > 0; }
  /// Sets the sigma of all features without one. Does nothing unless said().
  void apply(const Camera& camera, Features& features) const;
};

/// Parses "auto" (unknown), "1.5%", "stereo:PX,BASELINE" (sigma of the disparity in px, baseline in m), "structured-light"
/// (kStructuredLightSigma) or "rendered" (exact).
/// Throws Error(invalid_argument) that names the text and lists these forms.
DepthSigma parse_depth_sigma(const std::string& text);

}  // namespace iclk
