#pragma once
#include <span>
#include <vector>

#include <iclk/align/options.h>

namespace iclk::internal {

/// The robust scale: 1.4826 times the lower median of |r| over the finite entries. It is at least 1e-3 (feature units), so that
/// identical images do not get a scale of zero. 0 if no entry is finite.
float mad_scale(std::span<const float> residuals);

/// The weight w(r) at scale s, tuned for 95 % efficiency on Gaussian noise:
///   huber min(1, 1.345 s / |r|);  tukey (1 - (r / 4.685 s)^2)^2 inside, 0 outside;  cauchy 1 / (1 + (r / 2.3849 s)^2).
float robust_weight(Robust robust, float r, float scale);

/// One weight per residual; 0 for NaN.
std::vector<float> robust_weights(Robust robust, std::span<const float> residuals, float scale);

}  // namespace iclk::internal
