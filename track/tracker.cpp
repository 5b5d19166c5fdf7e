#include <iclk/track/tracker.h>

#include <cmath>
#include <utility>

#include <iclk/align/common/options_check.h>
#include <iclk/align/common/stopwatch.h>
#include <iclk/engine/error.h>
#include <iclk/track/internal/detector.h>
#include <iclk/track/internal/hidden.h>
#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace {

/// Checks an image before its pixels are read.
void check_view(const ImageView& image, const Camera& camera, PixelFormat format, const char* what) {
  const auto refuse = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, what + why); };
  if (image.width != camera.width || image.height != camera.height)
    refuse(" of " + std::to_string(image.width) + "x" + std::to_string(image.height) + ", but the camera has " +
           std::to_string(camera.width) + "x" + std::to_string(camera.height));
  if (image.stride() < static_cast<size_t>(image.width) * bytes_per_pixel(image.format))
    refuse(" with a row stride of " + std::to_string(image.row_stride) + " bytes, shorter than a row");
  if (image.format != format) refuse(format == PixelFormat::r8 ? " must be r8" : " must be r32f");
}

void check_frame(const TrackFrame& frame, const Camera& camera, const TrackerOptions& options) {
  check_view(frame.image, camera, frame.image.format, "an image");
  if (frame.image.data == nullptr) throw Error(ErrorCode::invalid_argument, "an image without pixels");
  if (!frame.depth.empty()) check_view(frame.depth, camera, PixelFormat::r32f, "depth");
  if (frame.features) check_features(*frame.features, camera);  // throws
  if (frame.mask.empty()) return;
  if (!options.masks) throw Error(ErrorCode::invalid_argument, "a mask needs TrackerOptions::masks");
  check_view(frame.mask, camera, PixelFormat::r8, "a mask");
}

/// Sets the pose that was found with a keyframe.
void tell(const internal::Found& found, const internal::Keyframe& k, TrackResult& result) {
  const RefinedAlignment& a = found.alignment;
  result.status = TrackStatus::tracked;
  result.confirmed = found.confirmed;
  result.reason = a.reason;
  result.keyframe = k.id;
  result.T_CK = a.T_10;
  result.T_WC = k.T_WC * a.T_10.inverse();
  result.T_WC.orthonormalize();
  result.covariance = a.covariance;
  result.features = k.features.size();
  result.visible = a.visible;
  result.inliers = a.inliers;
  result.sigma = a.sigma;
}

/// The tracker itself unrolls frames, with data of earlier frames too. `rolling_shutter`: the refiner does it.
RefinerOptions for_tracking(bool rolling_shutter = false) {
  RefinerOptions options;
  options.keep_unconfirmed = true;  // an unconfirmed alignment may still be credible (Judge)
  options.rolling_shutter = rolling_shutter;
  return options;
}

}  // namespace

const char* name(TrackStatus status) {
  switch (status) {
    case TrackStatus::tracked: return "tracked";
    case TrackStatus::keyframe: return "keyframe";
    case TrackStatus::lost: return "lost";
  }
  return "unknown";
}

void TrackerOptions::check() const {
  check_range("features of a keyframe", features, 10, 8192);
  check_range("depth sigma (constant)", depth_sigma.constant, 0, 1e6);
  check_range("depth sigma (disparity)", depth_sigma.disparity, 0, 1e9);
  check_range("depth sigma (relative)", depth_sigma.relative, 0, 10);
  if (!depth_sigma.said())
    throw Error(ErrorCode::invalid_argument,
                "depth sigma is 0: it must be positive; for exact depths use a relative sigma of 1e-6");
  check_range("seeds of a keyframe", seeds, 0, 8192);
  check_range("keyframes", keyframes, 2, 4096);
  check_range("archive", archive, 0, 100000);
  check_range("window", window, 1, 64);
  check_range("min_visible", min_visible, 0.1, 1);
  check_range("min_inliers", min_inliers, 6, 8192);
  check_range("readout", readout, -0.2, 0.2);
}

Plan Tracker::plan(const Camera& camera, const TrackerOptions& options) {
  Plan plan{.width = camera.width, .height = camera.height, .max_features = options.features};
  plan.max_references = options.keyframes + internal::Keyframes::kOpen + 1;  // and the frame that may begin a map
  plan.max_pairs = 2 * options.window;
  const bool masks = options.masks || options.readout != 0;  // unrolled images have pixels without a source
  plan.format = masks ? PixelFormat::rgba8 : PixelFormat::r8;
  plan.target_masks = masks;
  return plan;
}

Tracker::Impl::Impl(Aligner& aligner, const Camera& camera, const TrackerOptions& options)
    : aligner(aligner),
      camera(camera),
      options(options),
      judge{camera, options.min_inliers, options.min_visible},
      refiner(aligner, for_tracking()),
      unbending(aligner, for_tracking(true)),
      keyframes(aligner, camera, options.keyframes, options.archive),
      reach(keyframes),
      unroller(camera, options, judge, refiner),
      locator(camera, judge, refiner, unbending, keyframes, reach, aligner.plan().max_pairs),
      places(camera, judge, refiner, keyframes, options.window),
      loops(camera, judge, keyframes),
      window(camera, judge, refiner, keyframes, options.window),
      seeder(camera, this->options, judge) {}

/// The numbers are those of docs/explain/tracking.md, which explains the steps.
TrackResult Tracker::Impl::track(const TrackFrame& given) {
  check(given);
  last_time = given.time;
  ++keyframes.clock;
  Frame frame(given);
  TrackResult result;
  result.time = given.time;
  result.map = keyframes.current_map();
  if (keyframes.empty()) return begin(frame, std::move(result));
  const internal::Stopwatch watch;
  unroller.unroll(frame);                              // 1
  std::optional<Found> found = locate(frame, result);  // 2, 3
  if (found) unroller.unroll_again(frame, *keyframes.find(found->keyframe), motion, *found);
  result.align_ms = watch.ms();
  if (!found) return lose(frame, std::move(result));
  internal::Keyframe& k = *keyframes.find(found->keyframe);
  locator.state.current = k.id;
  keyframes.enter(k.map);
  k.used = keyframes.clock;
  tell(*found, k, result);
  unroller.learn(frame, k, *found, motion, result.T_WC);
  const TrackResult::Origin origin{k.id, result.T_CK, found->confirmed, result.covariance};
  if (judge.becomes_keyframe(frame, k, *found, result.T_WC, previous.pixels.frame(camera))) {  // 4
    unroller.straighten(frame);
    if (make_keyframe(frame, result.T_WC, origin, &*found, result) && !motion.lost && options.archive > 0)
      recognise(keyframes.newest(), result);  // 6
  }
  if (result.status == TrackStatus::tracked && found->confirmed) look_for_seeds(k, frame, found->alignment, result);  // 5
  keep(given, frame.rate, origin, result.T_WC);
  return result;
}

void Tracker::Impl::check(const TrackFrame& given) const {
  check_frame(given, camera, options);
  if (!std::isfinite(given.time))
    throw Error(ErrorCode::invalid_argument,
                "a frame's time is " + std::to_string(given.time) + "; it must be finite, in seconds");
  if (last_time && given.time <= *last_time)
    throw Error(ErrorCode::invalid_argument, "frame at " + std::to_string(given.time) + " s does not come after the one at " +
                                                 std::to_string(*last_time) + " s");
}

TrackResult Tracker::Impl::begin(Frame& frame, TrackResult result) {
  unroller.begin();
  if (!make_keyframe(frame, {}, {}, nullptr, result)) {
    result.reason = "no frame with depth and texture yet";
    return result;
  }
  result.reason =
      maps == 1 ? "the first keyframe" : "a new map: the camera was lost for longer than the last map had tracked it";
  frames_tracked = 0;
  result.confirmed = true;
  keep(frame.seen(), Eigen::Vector3d::Zero(), {}, result.T_WC);
  return result;
}

std::optional<internal::Found> Tracker::Impl::locate(Frame& frame, TrackResult& result) {
  constexpr double kLikely = 0.5, kAtAll = -1;  // least visible share of a credible keyframe
  const TrackFrame& seen = frame.seen();
  if (!motion.lost) {
    internal::Search search{motion.predict(seen.time)};
    if (auto found = locator.follow(seen, search)) return found;
    result.searched = true;
    if (auto found = locator.try_others(seen, motion, search)) return found;
    if (auto found = locator.credible(search, kLikely)) return found;
    if (make_previous_keyframe(result))  // the most similar frame
      if (auto found = locator.try_current(seen, motion, search)) return found;
    if (auto found = locator.credible(search, kAtAll)) return found;
    return align_learned(seen, search.expected);
  }
  result.searched = true;
  if (auto found = locator.relocalise(frame, motion.last->T_WC)) return found;
  if (auto found = align_learned(seen, motion.last->T_WC)) return found;
  return follow_unplaced(seen, result);
}

std::optional<internal::Found> Tracker::Impl::align_learned(const TrackFrame& frame, const SE3& expected) {
  constexpr int kStale = 2;                                 // frames, after which no pose is expected
  const bool due = (frames_lost & (frames_lost - 1)) == 0;  // less and less often while the camera is lost
  const internal::Keyframe* current = keyframes.find(locator.state.current);
  return learned && due && current ? learned->find(frame, *current, expected, frames_lost < kStale) : std::nullopt;
}

std::optional<internal::Found> Tracker::Impl::follow_unplaced(const TrackFrame& frame, TrackResult& result) {
  if (!unplaced) return {};
  Frame before(unplaced->frame(camera));
  auto a = align_with_unplaced(
      frame, {.image = before.seen().image, .camera = camera, .features = measure(before), .inverse_depth = {}});
  if (!a) return {};
  const int old = keyframes.current_map();
  keyframes.enter(maps);
  TrackResult made;
  if (!make_keyframe(before, {}, {}, nullptr, made)) {
    keyframes.enter(old);
    return {};
  }
  ++maps;
  frames_tracked = 1;
  unroller.begin();
  motion.last = internal::Motion::Last{before.given.time, {}};
  result.map = keyframes.current_map();
  result.before = TrackResult::Before{made.keyframe, before.given.time};
  return Found{made.keyframe, std::move(*a)};
}

std::optional<RefinedAlignment> Tracker::Impl::align_with_unplaced(const TrackFrame& frame, const Reference& unplaced_frame) {
  const int spare = options.keyframes + internal::Keyframes::kOpen;
  aligner.set_reference(spare, unplaced_frame);
  for (const bool search : {false, true}) {
    RefinedAlignment a = refiner.align({spare, frame.image, {}, {}, search, frame.mask});
    if (judge.confirmed(a)) return a;
  }
  return {};
}

TrackResult Tracker::Impl::lose(Frame& frame, TrackResult result) {
  result.T_WC = motion.last->T_WC;
  result.reason = "not found at the predicted pose, nor by a search among " + std::to_string(keyframes.size()) + " keyframes";
  if (!motion.lost) reach.leave(locator.state.current, from_keyframe(result.T_WC), motion.last->time, way);
  motion.lose();
  unroller.lose();
  ++frames_lost;
  if (measure(frame).size() < least_features()) return result;
  unplaced.emplace().keep(frame.given);
  internal::fill_hidden(*unplaced, camera);
  if (frames_lost <= frames_tracked) return result;
  keyframes.enter(maps++);  // the map began with a bad frame
  result.map = keyframes.current_map();
  return begin(frame, std::move(result));
}

void Tracker::Impl::keep(const TrackFrame& pixels, const Eigen::Vector3d& rate,
                         const std::optional<TrackResult::Origin>& origin, const SE3& T_WC) {
  if (motion.lost) {
    reach.arrive(*keyframes.find(locator.state.current), from_keyframe(T_WC), pixels.time);
  } else if (motion.last) {
    const double step = (T_WC.t - motion.last->T_WC.t).norm();
    reach.move(step, pixels.time - motion.last->time);
    way += step;
  }
  motion.add(pixels.time, T_WC);
  unplaced.reset();
  ++frames_tracked;
  frames_lost = 0;
  previous.pixels.keep(pixels);
  previous.rate = rate;
  previous.origin = origin;
}

double Tracker::Impl::from_keyframe(const SE3& T_WC) const {
  return (T_WC.t - keyframes.places()[static_cast<size_t>(locator.state.current)].T_WC.t).norm();
}

Tracker::Tracker(const Session& session, const Camera& camera, const TrackerOptions& options) {
  options.check();
  Plan needed = plan(camera, options);
  if (session.stages().front().model) needed.format = PixelFormat::rgba8;
  own_ = session.make_aligner(needed);
  impl_ = std::make_unique<Impl>(*own_, camera, options);
  if (session.stages().size() == 1) return;
  SessionOptions later = session.options();
  later.stages.assign(session.stages().begin() + 1, session.stages().end());
  later.refiner = for_tracking();
  impl_->learned.emplace(camera, impl_->judge, std::move(later), session.context());
}

Tracker::Tracker(Aligner& aligner, const Camera& camera, const TrackerOptions& options) {
  options.check();
  camera.check();
  const Plan needed = plan(camera, options), &has = aligner.plan();
  if (has.width != needed.width || has.height != needed.height || has.max_references < needed.max_references ||
      has.max_features < needed.max_features || has.max_pairs < needed.max_pairs || has.target_masks < needed.target_masks)
    throw Error(ErrorCode::invalid_argument, "the aligner was not made with Tracker::plan()");
  impl_ = std::make_unique<Impl>(aligner, camera, options);
}

Tracker::~Tracker() = default;

TrackResult Tracker::track(const TrackFrame& frame) { return impl_->track(frame); }
int Tracker::keyframe_count() const { return static_cast<int>(impl_->keyframes.places().size()); }
const SE3& Tracker::keyframe_pose(int id) const { return impl_->keyframes.places().at(static_cast<size_t>(id)).T_WC; }
int Tracker::keyframe_map(int id) const { return impl_->keyframes.places().at(static_cast<size_t>(id)).map; }

std::vector<MapPoint> Tracker::map() const {
  std::vector<MapPoint> out;
  for (const auto& [id, k] : impl_->keyframes.all()) {
    const Map grey = grey_map(k.pixels.frame(impl_->camera).image);
    for (size_t i = 0; i < k.features.uv.size(); ++i) {
      const Eigen::Vector2d& uv = k.features.uv[i];
      const Eigen::Vector3d X = k.T_WC * (impl_->camera.ray(uv) / k.features.inverse_depth[i]);
      out.push_back({id, k.map, uv, X, grey.bilinear(uv.x(), uv.y())});
    }
  }
  return out;
}

Readout Tracker::readout() const {
  const internal::ReadoutEstimate& estimate = impl_->unroller.state.readout;
  return {estimate.seconds(), estimate.sigma()};
}

}  // namespace iclk
