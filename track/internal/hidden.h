#pragma once
#include <iclk/track/internal/frame.h>

namespace iclk::internal {

/// Replaces what a mask hides by a smooth continuation of what is seen. References have no masks. At coarse levels, patches of
/// features reach far, and the own vehicle would seem to stand still in them.
void fill_hidden(FramePixels& pixels, const Camera& camera);

}  // namespace iclk::internal
