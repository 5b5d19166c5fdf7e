#pragma once
#include <Eigen/Core>

#include <iclk/track/internal/frame.h>

namespace iclk::internal {

/// The frame as a camera sees it that reads all its rows at once, at the frame's time. `turn`: rotation vector of the camera's
/// motion while its rows were read, rad, in its own axes; taken as even. `rows`: when it saw the frame's pixels. What the
/// camera shifts meanwhile stays in: it would need the depth of every pixel. Image: bilinear. Depth, as rolling as the image,
/// and mask: nearest. Where the source has nothing the mask is 0; without one in `frame`, so it is made.
void unroll(const TrackFrame& frame, const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& turn, FramePixels& out);

/// Where a pixel of an image that was unrolled with the turn `from` is found in one that is unrolled with `to`.
Eigen::Vector2d unrolled_anew(const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& from,
                              const Eigen::Vector3d& to, const Eigen::Vector2d& uv);

}  // namespace iclk::internal
