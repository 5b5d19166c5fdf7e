#include <iclk/track/internal/learned_locator.h>

#include <utility>

namespace iclk::internal {

LearnedLocator::LearnedLocator(const Camera& camera, const Judge& judge, SessionOptions options,
                               std::shared_ptr<engine::Context> context)
    : camera_(camera), judge_(judge), options_(std::move(options)), context_(std::move(context)) {
  options_.batch = 2;  // the starts of find()
}

std::optional<Found> LearnedLocator::find(const TrackFrame& frame, const Keyframe& k, const SE3& expected, bool recent) {
  if (!session_) session_ = std::make_unique<Session>(options_, context_);
  const Reference reference{
      .image = k.pixels.frame(camera_).image, .camera = camera_, .features = k.features, .inverse_depth = {}};
  std::vector<CascadePair> pairs;
  for (const bool search : {false, true})
    pairs.push_back({reference, frame.image, expected.inverse() * k.T_WC, search, frame.mask});
  std::vector<RefinedAlignment> found = session_->align(pairs);
  for (RefinedAlignment& a : found)
    if (judge_.confirmed(a)) return Found{k.id, std::move(a)};
  if (!recent) return {};
  if (judge_.credible(found[0], found[1], k)) return Found{k.id, std::move(found[0]), false};
  for (RefinedAlignment& a : found)
    if (judge_.credible(a, k, expected)) return Found{k.id, std::move(a), false};
  return {};
}

}  // namespace iclk::internal
