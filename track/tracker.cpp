#include <iclk/track/tracker.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>
#include <utility>

#include <iclk/align/common/options_check.h>
#include <iclk/engine/error.h>
#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace {

using Clock = std::chrono::steady_clock;

/// So little is left of a keyframe that a frame must become one, blurred or not.
constexpr double kLittleVisible = 0.5;
/// A frame without depth becomes a keyframe if features moved so much, as a share of the image's width, and if so few inliers,
/// times min_inliers or of those visible, are left.
constexpr double kSomeFlow = 0.03, kFewOfVisible = 0.5;
/// Frames with depth may be rare: one takes over from a keyframe that lacks it when features moved so much.
constexpr double kLittleFlow = 0.01;
constexpr int kFewInliers = 3;
/// A camera that went so far that the keyframe's depths are wrong by so many px shows it: features are found, but do not agree.
/// Below a half of them would confirm no pose.
constexpr double kCoarse = 1, kFewOfFound = 0.6;
/// Of the features that a sensor leaves to be found, those that others may bring: what is new needs places, too.
constexpr double kCarried = 0.6;
/// Other places have less texture: where features dwindle, a frame without depth may be less sharp than its keyframe, but not
/// than the frame before.
constexpr double kAsSharp = 0.9;
/// A frame that is so much sharper than its keyframe is the better one.
constexpr double kMuchSharper = 1.3;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// In front of all that reads pixels.
void check_view(const ImageView& image, const Camera& camera, PixelFormat format, const char* what) {
  const auto refuse = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, what + why); };
  if (image.width != camera.width || image.height != camera.height)
    refuse(" of " + std::to_string(image.width) + "x" + std::to_string(image.height) + ", the camera has " +
           std::to_string(camera.width) + "x" + std::to_string(camera.height));
  if (image.stride() < static_cast<size_t>(image.width) * bytes_per_pixel(image.format))
    refuse(" with a row stride of " + std::to_string(image.row_stride) + " bytes, shorter than a row");
  if (image.format != format) refuse(format == PixelFormat::r8 ? " has to be r8" : " has to be r32f");
}

void check_frame(const TrackFrame& frame, const Camera& camera, const TrackerOptions& options) {
  check_view(frame.image, camera, frame.image.format, "an image");
  if (frame.image.data == nullptr) throw Error(ErrorCode::invalid_argument, "an image without pixels");
  if (!frame.depth.empty()) check_view(frame.depth, camera, PixelFormat::r32f, "depth");
  if (frame.mask.empty()) return;
  if (!options.masks) throw Error(ErrorCode::invalid_argument, "a mask needs TrackerOptions::masks");
  check_view(frame.mask, camera, PixelFormat::r8, "a mask");
}

RefinerOptions for_tracking(RefinerOptions options) {
  options.keep_unconfirmed = true;  // what the alignment says may still be credible (Impl::credible)
  options.rolling_shutter = false;  // frames are unrolled here, by what the frames before tell as well
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
  check_range("features of a keyframe", detector.count, 10, 8192);
  check_range("depth noise (constant)", depth_noise.constant, 0, 1e6);
  check_range("depth noise (relative)", depth_noise.relative, 0, 10);
  if (depth_noise.constant + depth_noise.relative == 0)
    throw Error(ErrorCode::invalid_argument, "depth noise is 0: give a sigma; of exact depths a relative one of 1e-6");
  check_range("seeds of a keyframe", seeds, 0, 8192);
  check_range("keyframes", keyframes, 2, 4096);
  check_range("window", window, 1, 64);
  check_range("min_visible", min_visible, 0.1, 1);
  check_range("max_flow", max_flow, 0.01, 1);
  check_range("min_inliers", min_inliers, 6, 8192);
  check_range("weak_correlation", weak_correlation, 0, 1);
  check_range("weak_motion", weak_motion, 0, 1);
  check_range("readout", readout, -0.2, 0.2);
  check_range("min_sharpness", min_sharpness, 0, 1);
  refiner.check();
}

Plan Tracker::plan(const Camera& camera, const TrackerOptions& options) {
  Plan plan{.width = camera.width, .height = camera.height, .max_features = options.detector.count};
  plan.max_references = options.keyframes;
  plan.max_pairs = 2 * options.window;
  const bool masks = options.masks || options.readout != 0;  // unrolled images are not seen everywhere
  plan.format = masks ? PixelFormat::rgba8 : PixelFormat::r8;
  plan.target_masks = masks;
  return plan;
}

Tracker::Impl::Impl(Aligner& aligner, const Camera& camera, const TrackerOptions& options)
    : aligner(aligner),
      camera(camera),
      options(options),
      rows(options.rows.value_or(RowTimes(camera))),
      refiner(aligner, for_tracking(options.refiner)),
      keyframes(options.keyframes) {}

void Tracker::Impl::set_reference(const Keyframe& k) {
  aligner.set_reference(k.slot,
                        {.image = k.pixels.frame(camera).image, .camera = camera, .features = k.features, .inverse_depth = {}});
}

/// Whether a map could begin with it.
bool Tracker::Impl::can_begin(const TrackFrame& frame) const {
  return !frame.depth.empty() &&
         detect_corners(grey_map(frame.image), frame.depth, frame.mask, options.depth_noise, options.detector).size() >=
             2 * options.min_inliers;
}

bool Tracker::Impl::make_keyframe(const TrackFrame& frame, const SE3& T_WC, const std::optional<Keyframe::Origin>& origin,
                                  const Found* found, TrackResult& result) {
  const auto start = Clock::now();
  const Map grey = grey_map(frame.image);
  Features features;
  if (!frame.depth.empty()) features = detect_corners(grey, frame.depth, frame.mask, options.depth_noise, options.detector);
  const int measured = features.size();
  if (measured < 2 * options.min_inliers && (options.seeds == 0 || keyframes.empty())) return false;
  std::vector<Neighbour> neighbours = neighbours_of(frame, T_WC, found);
  // A sensor that has enough needs no help, and is better.
  const bool help = options.seeds > 0 && measured < options.detector.count;
  if (help) carry(frame, neighbours, static_cast<int>(kCarried * (options.detector.count - measured)), features);
  if (features.size() < 2 * options.min_inliers) return false;
  Keyframe& k = keyframes.add(frame.time, T_WC);
  k.sharpness = sharpness(grey);
  k.turn = bent.turn;
  k.turn_sigma = bent.sigma;
  k.seen_turn = bent.seen;
  k.origin = origin;
  k.with_depth = 2 * measured >= features.size();
  k.features = std::move(features);
  if (help) sow(k, grey, frame);
  k.measured = k.features.inverse_depth;
  k.sigma = k.features.inverse_depth_sigma;
  k.sigma.resize(k.measured.size());
  k.pixels.keep(frame);
  k.pixels.depth.clear();  // its features have what is needed
  set_reference(k);
  connect(k, neighbours);
  result.keyframe_ms = milliseconds_since(start);
  const auto bundle_start = Clock::now();
  adjust_window();
  result.bundle_ms = milliseconds_since(bundle_start);
  const auto seeds_start = Clock::now();
  look_back(k, neighbours);
  result.keyframe_ms += milliseconds_since(seeds_start);
  current = k.id;
  result.status = TrackStatus::keyframe;
  result.keyframe = k.id;
  result.T_CK = {};
  result.T_WC = k.T_WC;
  result.covariance.setZero();  // it is its own reference; of how it was found the origin tells
  result.origin = origin;
  return true;
}

bool Tracker::Impl::disagree(const Keyframe& k, const RefinedAlignment& a) const {
  const auto found =
      std::count_if(a.features.begin(), a.features.end(), [](const auto& f) { return f.status == FeatureStatus::aligned; });
  const double sum = std::accumulate(k.sigma.begin(), k.sigma.end(), 0.0), count = static_cast<double>(k.sigma.size());
  return std::abs(camera.fx) * a.T_10.t.norm() * sum > kCoarse * count && a.inliers < kFewOfFound * static_cast<double>(found);
}

void Tracker::Impl::lose() {
  lost = true;
  velocity.reset();
  turned.reset();
  rate.setZero();
  rate_changes.interrupt();
}

void Tracker::Impl::begin(const TrackFrame& frame, TrackResult& result) {
  bent = {};  // whatever it is bent by, the others are seen in relation to it
  if (!make_keyframe(frame, {}, {}, nullptr, result)) {
    result.reason = "no frame with depth and texture yet";
    return;
  }
  result.reason = map == 0 ? "the first keyframe" : "a new map: the last one lost the camera for longer than it had it";
  result.confirmed = true;
  lost = false;
  frames_tracked = 1;
  frames_lost = 0;
  last = Last{frame.time, result.T_WC};
  previous.keep(frame);
  previous_rate.setZero();
  previous_origin.reset();
}

Tracker::Tracker(const Session& session, const Camera& camera, const TrackerOptions& options) {
  options.check();
  Plan needed = plan(camera, options);
  if (session.stages().front().model) needed.format = PixelFormat::rgba8;
  own_ = session.make_aligner(needed);
  impl_ = std::make_unique<Impl>(*own_, camera, options);
}

Tracker::Tracker(Aligner& aligner, const Camera& camera, const TrackerOptions& options) {
  options.check();
  camera.check();
  const Plan needed = plan(camera, options), &has = aligner.plan();
  if (has.width != needed.width || has.height != needed.height || has.max_references < needed.max_references ||
      has.max_features < needed.max_features || has.max_pairs < needed.max_pairs || has.target_masks < needed.target_masks)
    throw Error(ErrorCode::invalid_argument, "the aligner was not made for Tracker::plan()");
  impl_ = std::make_unique<Impl>(aligner, camera, options);
}

Tracker::~Tracker() = default;

TrackResult Tracker::track(const TrackFrame& given) {
  Impl& m = *impl_;
  TrackFrame frame = given;
  check_frame(frame, m.camera, m.options);
  if (!std::isfinite(frame.time))
    throw Error(ErrorCode::invalid_argument, "a frame's time is " + std::to_string(frame.time) + ", seconds are wanted");
  if (m.last_time && frame.time <= *m.last_time)
    throw Error(ErrorCode::invalid_argument, "frame at " + std::to_string(frame.time) + " s does not come after the one at " +
                                                 std::to_string(*m.last_time) + " s");
  m.last_time = frame.time;
  TrackResult result;
  result.time = frame.time;
  result.map = m.map;
  if (m.keyframes.empty()) {
    m.begin(frame, result);
    return result;
  }
  const auto start = Clock::now();
  frame = m.unrolled(given, m.rate);
  auto found = m.find_pose(frame, result);
  if (found && m.rolls() && !m.lost) m.unroll_again(given, *found);
  const Eigen::Vector3d rate = m.rate;
  const auto unroll_frame = [&] {
    if (m.rolls() && m.flat_rate != rate) frame = m.unrolled(given, rate);
  };
  result.align_ms = milliseconds_since(start);
  if (!found) {
    result.T_WC = m.last->T_WC;
    result.reason =
        "not found from where it was expected, nor by a search among " + std::to_string(m.keyframes.size()) + " keyframes";
    m.lose();
    if (++m.frames_lost > m.frames_tracked && m.can_begin(frame)) {
      m.keyframes.forget();
      result.map = ++m.map;
      m.begin(frame, result);
    }
    return result;
  }
  const RefinedAlignment& a = found->alignment;
  Keyframe& k = *m.keyframes.find(found->keyframe);
  m.current = k.id;
  result.status = TrackStatus::tracked;
  result.confirmed = found->confirmed;
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

  m.learn_turn(*found, frame.time, result.T_WC);
  const Keyframe::Origin origin{k.id, a.T_10, found->confirmed, a.covariance};
  const Overlap seen = overlap(m.camera, k, result.T_WC);
  const bool little = seen.visible < kLittleVisible;
  // A sensor's depths are better than those by motion; without them features can only be carried over while they are found.
  const bool few = a.inliers < kFewInliers * m.options.min_inliers || a.inliers < kFewOfVisible * a.visible;
  const bool coarse = m.disagree(k, a);
  const bool moved = seen.flow > kSomeFlow * m.camera.width;
  const bool renew =
      frame.depth.empty() ? moved && few : (moved && coarse) || (!k.with_depth && seen.flow > kLittleFlow * m.camera.width);
  if (little || renew || !found->confirmed || seen.visible < m.options.min_visible ||
      seen.flow > m.options.max_flow * m.camera.width) {
    const double sharp = sharpness(grey_map(frame.image)), ratio = sharp / k.sharpness;
    const auto as_the_last = [&] { return sharp > kAsSharp * sharpness(grey_map(m.previous.frame(m.camera).image)); };
    if (little || ratio > (found->confirmed ? m.options.min_sharpness : kMuchSharper) ||
        (found->confirmed && frame.depth.empty() && renew && as_the_last())) {
      unroll_frame();
      m.make_keyframe(frame, result.T_WC, origin, &*found, result);
    }
  }
  if (result.status == TrackStatus::tracked && found->confirmed && !k.seeds.empty()) {
    const auto seeds_start = Clock::now();
    unroll_frame();
    m.look(k, frame, a);
    result.keyframe_ms += milliseconds_since(seeds_start);
  }
  if (!m.lost) {
    m.velocity = m.last->T_WC.inverse() * result.T_WC;
    m.velocity_seconds = frame.time - m.last->time;
  }
  m.lost = false;
  ++m.frames_tracked;
  m.frames_lost = 0;
  m.last = Impl::Last{frame.time, result.T_WC};
  m.previous.keep(given);
  m.previous_rate = rate;
  m.previous_origin = origin;
  return result;
}

int Tracker::keyframe_count() const { return impl_->keyframes.count(); }
const SE3& Tracker::keyframe_pose(int id) const { return impl_->keyframes.pose(id); }
const ReadoutEstimate& Tracker::readout() const { return impl_->readout; }
const Keyframes& Tracker::keyframes() const { return impl_->keyframes; }

}  // namespace iclk
