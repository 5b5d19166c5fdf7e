#pragma once
#include <cstdint>
#include <optional>
#include <vector>

#include <iclk/align/pyramid.h>
#include <iclk/track/tracker.h>

namespace iclk::internal {

/// A copy of a frame's images, rows packed, and of its features.
struct FramePixels {
  double time = 0;
  std::vector<uint8_t> image, mask;
  std::vector<float> depth;
  std::optional<Features> features;
  PixelFormat format = PixelFormat::r8;

  void keep(const TrackFrame& frame);
  /// A view of this copy, which must outlive it.
  TrackFrame frame(const Camera& camera) const;
};

/// A frame in the tracker. Everything that is derived from it is computed once.
class Frame {
 public:
  explicit Frame(const TrackFrame& as_it_came) : given(as_it_came), seen_(as_it_came) {}

  const TrackFrame given;
  Eigen::Vector3d rate = Eigen::Vector3d::Zero();  ///< turn rate for the rolling shutter correction, rad/s
  std::optional<Features> measured;                ///< with depth from a sensor; empty before they are detected

  /// The images to use: `given`, or its correction for a rolling shutter.
  const TrackFrame& seen() const { return seen_; }
  void see(const TrackFrame& unrolled);
  const Map& grey() { return levels(1)[0]; }
  double sharpness();        ///< energy of the seen gradients at half the size; blur reduces it
  const Pyramid& pyramid();  ///< for feature alignment: grey, with masked pixels hidden

 private:
  const Pyramid& levels(int least);

  TrackFrame seen_;
  Pyramid levels_, hidden_;
  std::optional<double> sharpness_;
};

}  // namespace iclk::internal
