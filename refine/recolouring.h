#pragma once
#include <iclk/align/pyramid.h>

namespace iclk {

/// Weights w with which the target's grey values w . C fit the reference best. Changes of hue or white balance move brightness
/// between the channels; with luma the remaining difference would displace patches.
struct Recolouring {
  GreyWeights weights = kLuma;
  /// The unexplained variation of the patches with w, divided by that with luma; each patch has its own gain and bias.
  double unexplained = 1;
  bool better() const { return weights != kLuma; }
};

}  // namespace iclk
