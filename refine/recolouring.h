#pragma once
#include <iclk/align/pyramid.h>

namespace iclk {

/// Weights w for which the target's grey values w . C are most like the reference's: a change of hue or of a camera's white
/// balance moves what luma weighs from one channel into another, and what is left of it displaces patches.
struct Recolouring {
  GreyWeights weights = kLuma;
  /// What w leaves unexplained of the patches, over what luma leaves; each patch has its own gain and bias.
  double unexplained = 1;
  bool better() const { return weights != kLuma; }
};

}  // namespace iclk
