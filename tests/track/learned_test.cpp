// Frames that only a learned model aligns, and that no feature confirms.
#include <cstdlib>

#include <iclk/session/session.h>

#include "flight.h"

namespace iclk::test {
namespace {

/// The mean of (2 * radius + 1)^2 pixels, inside the image.
std::vector<uint32_t> blurred(const View& view, int radius) {
  std::vector<uint32_t> out(view.rgba.size());
  for (int v = 0; v < view.height; ++v)
    for (int u = 0; u < view.width; ++u) {
      uint32_t sum[3] = {}, count = 0;
      for (int y = std::max(v - radius, 0); y <= std::min(v + radius, view.height - 1); ++y)
        for (int x = std::max(u - radius, 0); x <= std::min(u + radius, view.width - 1); ++x, ++count)
          for (int c = 0; c < 3; ++c) sum[c] += view.rgba[static_cast<size_t>(y * view.width + x)] >> (8 * c) & 0xff;
      uint32_t& pixel = out[static_cast<size_t>(v * view.width + u)] = 0xff000000;
      for (int c = 0; c < 3; ++c) pixel |= sum[c] / count << (8 * c);
    }
  return out;
}

/// At a start in a map no pose is expected, so a learned model's pose that no feature confirms could be of another place.
TEST(LearnedTracker, StartsInAMapOnlyWhereFeaturesConfirm) {
  ICLK_NEED_DEVICE();
  setenv("ICLK_MODELS", ICLK_SOURCE_DIR "/models", 1);  // of the tree: nothing is installed here
  const Flight& flight = Flight::get();
  const Session session({.model = "auto"}, device());
  Tracker earlier(session, flight.camera, options_for());
  for (int i = 0; i < 6; ++i) earlier.track(flight.frame(i));
  Tracker later(session, flight.camera, options_for());
  later.start_in(earlier.state());

  const auto track_blurred = [&](Tracker& tracker, size_t i) {
    const std::vector<uint32_t> pixels = blurred(flight.views[i], 6);
    TrackFrame frame = flight.frame(static_cast<int>(i));
    frame.image.data = pixels.data();
    return tracker.track(frame);
  };
  const TrackResult known = track_blurred(earlier, 6);
  EXPECT_NE(known.status, TrackStatus::lost) << known.reason;
  EXPECT_FALSE(known.confirmed) << known.reason;
  EXPECT_EQ(track_blurred(later, 5).status, TrackStatus::lost);  // although the camera has not moved
  const TrackResult sharp = later.track(flight.frame(6));
  EXPECT_NE(sharp.status, TrackStatus::lost) << sharp.reason;
  EXPECT_TRUE(sharp.confirmed) << sharp.reason;
}

}  // namespace
}  // namespace iclk::test
