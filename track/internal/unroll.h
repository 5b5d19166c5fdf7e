#pragma once
#include <Eigen/Core>

#include <iclk/track/internal/frame.h>

namespace iclk::internal {

/// Corrects a frame for a rolling shutter: the result is the image of a global shutter at the frame's time. `turn`: the
/// rotation vector of the camera while its rows were read, rad, in its axes; the rotation is assumed to be uniform. `rows`: the
/// time at which each pixel was read. Translation during the readout is not corrected, because that needs the depth of every
/// pixel.
///
/// The image is interpolated bilinearly. Depth, which rolls like the image, and mask take the nearest pixel. Features move with
/// their pixels. Pixels without a source get a mask of 0; if `frame` has no mask, one is made.
void unroll(const TrackFrame& frame, const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& turn, FramePixels& out);

/// Converts a pixel of an image that was unrolled with the turn `from` to one that is unrolled with `to`.
Eigen::Vector2d unrolled_anew(const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& from,
                              const Eigen::Vector3d& to, const Eigen::Vector2d& uv);

}  // namespace iclk::internal
