#pragma once
#include <cstdint>
#include <optional>
#include <vector>

#include <iclk/align/pyramid.h>
#include <iclk/track/tracker.h>

namespace iclk::internal {

/// A copy of a frame's images, rows packed.
struct FramePixels {
  double time = 0;
  std::vector<uint8_t> image, mask;
  std::vector<float> depth;
  PixelFormat format = PixelFormat::r8;

  void keep(const TrackFrame& frame);
  /// Of this copy, which must outlive it.
  TrackFrame frame(const Camera& camera) const;
};

/// A frame on its way through a tracker, and what was computed of it, each once.
class Frame {
 public:
  explicit Frame(const TrackFrame& as_it_came) : given(as_it_came), seen_(as_it_came) {}

  const TrackFrame given;
  Eigen::Vector3d rate = Eigen::Vector3d::Zero();  ///< rad/s, with which it is to be unrolled
  std::optional<Features> measured;                ///< where a sensor has depth, once they were looked for

  /// What is looked at: `given`, unrolled where its camera has a rolling shutter.
  const TrackFrame& seen() const { return seen_; }
  void see(const TrackFrame& unrolled);
  const Map& grey() { return levels(1)[0]; }
  double sharpness();        ///< energy of the gradients at half the size: what blur takes away
  const Pyramid& pyramid();  ///< for feature alignment: grey, what the mask hides marked

 private:
  const Pyramid& levels(int least);

  TrackFrame seen_;
  Pyramid levels_, hidden_;
  std::optional<double> sharpness_;
};

}  // namespace iclk::internal
