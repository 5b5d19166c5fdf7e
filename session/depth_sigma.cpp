#include <iclk/session/depth_sigma.h>

#include <cmath>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

constexpr double kExact = 1e-6;  // the single precision of a z-buffer

/// Parses a positive, finite number; 0 for all other words.
double positive_number(std::string_view text) {
  const double x = to_number(text).value_or(0);
  return std::isfinite(x) && x > 0 ? x : 0;
}

}  // namespace

void DepthSigma::apply(const Camera& camera, Features& features) const {
  if (!said()) return;
  features.inverse_depth_sigma.resize(features.uv.size(), 0.0);
  for (size_t i = 0; i < features.uv.size(); ++i) {
    double& sigma = features.inverse_depth_sigma[i];
    if (std::isfinite(sigma) && sigma > 0) continue;
    sigma = constant + disparity / std::abs(camera.fx) + relative * features.inverse_depth[i];
  }
}

DepthSigma parse_depth_sigma(const std::string& text) {
  DepthSigma sigma;
  if (text == "auto") return sigma;
  if (text == "rendered") sigma.relative = kExact;
  if (text == "structured-light") sigma.constant = kStructuredLightSigma;
  const std::string_view words = text;
  if (const std::string_view stereo = "stereo:"; words.starts_with(stereo)) {
    const std::string_view numbers = words.substr(stereo.size());
    const size_t comma = numbers.find(',');
    const double px = positive_number(numbers.substr(0, comma));
    const double baseline = comma == std::string_view::npos ? 0 : positive_number(numbers.substr(comma + 1));
    if (px > 0 && baseline > 0) sigma.disparity = px / baseline;
  } else if (words.ends_with('%')) {
    sigma.relative = positive_number(words.substr(0, words.size() - 1)) / 100;
  }
  if (!sigma.said())
    throw Error(ErrorCode::invalid_argument,
                "--depth-sigma '" + printable(text) +
                    "' must be auto, 1.5% (of the depth), stereo:PX,BASELINE (sigma of the disparity in px, baseline in m), "
                    "structured-light or rendered");
  return sigma;
}

}  // namespace iclk
