#pragma once
#include <string>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>

namespace iclk {

/// 1/m, of the inverse depths of structured light: a Kinect's depths are wrong by 0.0014 z^2 (Khoshelham and Oude Elberink
/// 2012). What trackers take where nothing is said.
inline constexpr double kStructuredLightSigma = 0.0014;

/// How wrong a sensor's depths are: a standard deviation of the inverse depth q, constant + relative q. Zero: not said.
struct DepthSigma {
  double constant = 0;   ///< 1/m; of stereo and structured light, whose depth errors grow with the square of the depth
  double disparity = 0;  ///< px m^-1: of stereo, the disparity's sigma over the baseline; divided by the focal length
  double relative = 0;   ///< of q

  bool said() const { return constant > 0 || disparity > 0 || relative > 0; }
  /// Gives a sigma to the features that have none of their own. Nothing if nothing is said.
  void apply(const Camera& camera, Features& features) const;
};

/// "auto" (nothing is said), "1.5%", "stereo:PX,BASELINE" (sigma of a disparity in px, m), "structured-light"
/// (kStructuredLightSigma) or "rendered" (exact).
/// Throws Error(invalid_argument) that names the text and lists these.
DepthSigma parse_depth_sigma(const std::string& text);

}  // namespace iclk
