// The keyframes of a tracker: how frames become keyframes, and where older ones are seen again.
#include <utility>

#include <iclk/align/common/stopwatch.h>
#include <iclk/track/internal/detector.h>
#include <iclk/track/internal/hidden.h>
#include <iclk/track/internal/tracker_impl.h>

namespace iclk {

bool Tracker::Impl::make_previous_keyframe(TrackResult& result) {
  if (keyframes.newest().time == previous.pixels.time) return false;
  internal::FramePixels straight;
  Frame before(unroller.unrolled(previous.pixels.frame(camera), previous.rate, straight));
  TrackResult made;
  if (!make_keyframe(before, motion.last->T_WC, previous.origin, nullptr, made)) return false;
  result.before = TrackResult::Before{made.keyframe, before.given.time};
  return true;
}

const Features& Tracker::Impl::measure(Frame& frame) const {
  if (frame.measured) return *frame.measured;
  const TrackFrame& seen = frame.seen();
  Features& out = frame.measured.emplace();
  if (seen.features)
    out = internal::choose_features(frame.grey(), *seen.features, seen.mask, camera, options.features);
  else if (!seen.depth.empty())
    out = internal::detect_corners(frame.grey(), seen.depth, seen.mask, options.features, options.border);
  options.depth_sigma.apply(camera, out);
  return out;
}

bool Tracker::Impl::make_keyframe(Frame& frame, const SE3& T_WC, const std::optional<TrackResult::Origin>& origin,
                                  const Found* found, TrackResult& result) {
  const internal::Stopwatch watch;
  Features features = measure(frame);
  const int measured = features.size();
  if (measured < least_features() && (options.seeds == 0 || keyframes.empty())) return false;
  std::vector<internal::Neighbour> neighbours = window.neighbours_of(frame.seen(), T_WC, found);
  if (seeder.helps(measured)) seeder.carry(frame.seen(), neighbours, features);
  if (features.size() < least_features()) return false;
  internal::Keyframe& k = keyframes.add(frame.given.time, T_WC);
  k.origin = origin;
  fill(k, frame, std::move(features), measured);
  keyframes.prepare(k);
  window.connect(k, neighbours);
  loops.follow(k, neighbours);
  const internal::Stopwatch bundle_watch;
  window.adjust();
  result.bundle_ms = bundle_watch.ms();
  if (seeder.look_back(k, frame, neighbours)) keyframes.prepare(k);
  keyframes.hold_next(k, options.window);  // neighbours may leave
  result.keyframe_ms = watch.ms() - result.bundle_ms;
  locator.state.current = k.id;
  result.status = TrackStatus::keyframe;
  result.keyframe = k.id;
  result.T_CK = {};
  result.T_WC = k.T_WC;
  result.covariance.setZero();  // it is its own reference; `origin` has the covariance of its alignment
  result.origin = origin;
  return true;
}

void Tracker::Impl::fill(internal::Keyframe& k, Frame& frame, Features features, int measured) {
  const auto& bent = unroller.state.bent;
  k.turn = bent.turn;
  k.turn_sigma = bent.sigma;
  k.seen_turn = bent.seen;
  k.sharpness = frame.sharpness();
  k.way = way;
  k.signature = internal::signature_of(frame.grey(), features.uv);
  k.with_depth = 2 * measured >= features.size();
  k.features = std::move(features);
  if (seeder.helps(measured)) seeder.sow(k, frame);
  k.measured = k.features.inverse_depth;
  k.sigma = k.features.inverse_depth_sigma;
  k.sigma.resize(k.measured.size());
  TrackFrame pixels = frame.seen();
  pixels.depth = {};  // its features have the needed depths
  pixels.features = nullptr;
  k.pixels.keep(pixels);
  internal::fill_hidden(k.pixels, camera);
}

void Tracker::Impl::look_for_seeds(internal::Keyframe& k, Frame& frame, const RefinedAlignment& a, TrackResult& result) {
  if (k.seeds.empty()) return;
  const internal::Stopwatch watch;
  unroller.straighten(frame);
  if (seeder.look(k, frame, a)) keyframes.prepare(k);
  result.keyframe_ms += watch.ms();
}

void Tracker::Impl::recognise(internal::Keyframe& k, TrackResult& result) {
  const internal::Stopwatch watch;
  internal::FramePixels straight;
  const TrackFrame last = unroller.unrolled(previous.pixels.frame(camera), previous.rate, straight);
  auto link = places.find(k, last, motion.last->T_WC);
  if (link) link_place(k, *link, result);
  result.keyframe_ms += watch.ms();
}

void Tracker::Impl::link_place(internal::Keyframe& k, internal::Link& link, TrackResult& result) {
  const SE3 before = k.T_WC;
  const internal::Keyframe& from = keyframes.open(link.edge.from);
  if (from.map != k.map) {
    if (!reach.allows(from, k, link.edge)) return;
    join_maps(k, link.edge);
  } else if (!loops.plausible(link.edge)) {
    reach.state.repeats = true;
    return;
  } else if (!loops.close(link.edge)) {
    return;
  }
  internal::Keyframe& other = keyframes.hold(link.edge.from);
  other.sightings[k.id] = std::move(link.there);
  k.sightings[other.id] = std::move(link.back);
  // The camera moves with its keyframe.
  const SE3 moved = k.T_WC * before.inverse();
  result.map = k.map;
  result.T_WC = k.T_WC;
  motion.last->T_WC = moved * motion.last->T_WC;
  if (auto& turned = unroller.state.turned) turned->T_WC_before = moved * turned->T_WC_before;
}

void Tracker::Impl::join_maps(internal::Keyframe& k, const internal::BundleEdge& link) {
  const auto [T_WC, there] = keyframes.places()[static_cast<size_t>(link.from)];
  const SE3 T_there_here = T_WC * (k.T_WC * link.T_to_from).inverse();
  if (k.map < there)
    keyframes.join(there, k.map, T_there_here.inverse());
  else
    keyframes.join(k.map, there, T_there_here);
  loops.join(link);
}

}  // namespace iclk
