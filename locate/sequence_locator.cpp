#include <iclk/locate/sequence_locator.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include <iclk/engine/error.h>
#include <iclk/locate/internal/pose_graph.h>
#include <iclk/session/session.h>
#include <iclk/track/tracker.h>

namespace iclk {
namespace {

constexpr double kDepthSigma = 0.01;  // of the depths that the map gives, relative
constexpr double kSwerve = 0.5;       // of the last motion: standard deviation of the next one
constexpr double kLeastTurn = 0.01;   // rad, of a prediction
constexpr double kUnconfirmed = 100;  // times the covariance, of motions that no features confirm
constexpr double kLeastShown = 0.75;  // of a view: at the map's border, motion tells more depths than the map
constexpr double kLostGrowth = 2;     // times the last speed, m/s, by which the position of a lost camera becomes unknown

/// T^(share): the same motion in another time.
SE3 part(const SE3& T, double share) { return SE3::exp(share * T.log()); }

SessionOptions tracking_options(SessionOptions options) {
  options.model = "classical";
  options.stages.clear();
  options.search = SearchMode::on;
  return options;
}

TrackerOptions tracker_options(const SequenceLocatorOptions& options) {
  TrackerOptions tracker;
  tracker.depth_sigma = {.relative = kDepthSigma};
  tracker.masks = options.masks;
  tracker.archive = 0;  // anchors on the map take the place of loops
  return tracker;
}

/// The number of pixels that the map shows.
double shown(const View& view) {
  return static_cast<double>(std::count_if(view.depth.begin(), view.depth.end(), [](float z) { return z > 0; }));
}

double mean_depth(const View& view) {
  return std::accumulate(view.depth.begin(), view.depth.end(), 0.0) / std::max(1.0, shown(view));
}

}  // namespace

void SequenceLocatorOptions::check() const {
  const auto refuse = [](const char* what) { throw Error(ErrorCode::invalid_argument, what); };
  if (anchors < 1) refuse("anchors must be at least 1");
  if (!(drift >= 0 && drift < 1)) refuse("drift must be 0 to 1");
  if (!(contradiction > 0)) refuse("contradiction must be positive");
}

struct SequenceLocator::Impl {
  Locator& locator;
  Camera camera;
  SequenceLocatorOptions options;
  Session session;
  Tracker tracker;
  internal::PoseGraph graph;
  std::vector<SequencePose> frames;
  std::map<int, int> frame_of_keyframe;
  std::optional<LocatePrior> prior;  // the last that was given
  double distance = INFINITY;        // m to the ground, of the last located frame

  Impl(Locator& l, const Camera& c, const SequenceLocatorOptions& o)
      : locator(l),
        camera(c),
        options(o),
        session(tracking_options(l.options().session), l.context()),
        tracker(session, camera, tracker_options(o)) {}

  std::optional<LocatePrior> predicted(double time) const;
  TrackResult track(const LocatorFrame& frame, const Located& located);
  void connect(const TrackResult& result);
  int frame_at(double time) const;
  bool drop(int frame, Located& located);
  void add_motion(int from, int to, const SE3& T_to_from, const Matrix6d& covariance, bool confirmed);
  LocatePrior around(int frame) const;
  bool anchored(int frame) const { return frames[static_cast<size_t>(frame)].located.converged(); }
  Matrix6d covariance(int frame) const;
  SequencePose locate(const LocatorFrame& frame);
};

/// Errors of the map are those of neighbouring anchors, too: these do not average out. A located frame keeps the covariance
/// that it has alone; a tracked one adds that of the nearest located frame.
Matrix6d SequenceLocator::Impl::covariance(int frame) const {
  const auto located = [&](int i) { return i >= 0 && i < static_cast<int>(frames.size()) && anchored(i); };
  int near = 0;
  while (near < graph.size() && !located(frame - near) && !located(frame + near)) ++near;
  if (near == graph.size()) return graph.covariance(frame);
  const int anchor = located(frame - near) ? frame - near : frame + near;
  const Matrix6d& alone = frames[static_cast<size_t>(anchor)].located.covariance;
  if (near == 0) return alone;
  Matrix6d turn = Matrix6d::Zero();
  turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = graph.pose(frame).R.transpose() * graph.pose(anchor).R;
  return graph.covariance(frame) + turn * alone * turn.transpose();
}

/// The pose of a frame that its motion tells.
LocatePrior SequenceLocator::Impl::around(int frame) const {
  const Matrix6d& C = graph.covariance(frame);
  const double position = std::sqrt(C.topLeftCorner<3, 3>().trace()), turn = std::sqrt(C.bottomRightCorner<3, 3>().trace());
  return {graph.pose(frame), position, position, turn + kLeastTurn, turn + kLeastTurn};
}

/// From the last known pose and the last known motion.
std::optional<LocatePrior> SequenceLocator::Impl::predicted(double time) const {
  int last = graph.size() - 1;
  while (last >= 0 && !graph.known(last)) --last;
  if (last < 0) return std::nullopt;
  LocatePrior prior = around(last);
  const double since = time - frames[static_cast<size_t>(last)].time;
  SE3 motion;
  double speed = 0;
  if (last > 0 && graph.known(last - 1)) {
    const double took = frames[static_cast<size_t>(last)].time - frames[static_cast<size_t>(last) - 1].time;
    const SE3 step = graph.pose(last - 1).inverse() * graph.pose(last);
    motion = part(step, std::min(since / took, 5.0));
    speed = step.t.norm() / took;
  }
  prior.T_WC = prior.T_WC * motion;
  const bool lost = last + 1 < graph.size();
  double far = kSwerve * motion.t.norm() + (lost ? kLostGrowth * speed * since : 0);
  double turn = kSwerve * motion.angle() + (lost ? kSwerve * (graph.size() - 1 - last) * kLeastTurn : 0);
  if (speed == 0 && this->prior) far = this->prior->position_sigma, turn = this->prior->tilt_sigma;
  prior.position_sigma += far, prior.height_sigma += far;
  prior.tilt_sigma = std::min(prior.tilt_sigma + turn, 0.3);
  prior.heading_sigma = std::min(prior.heading_sigma + 2 * turn, M_PI);
  return prior;
}

void SequenceLocator::Impl::add_motion(int from, int to, const SE3& T_to_from, const Matrix6d& covariance, bool confirmed) {
  Matrix6d C = (confirmed ? 1 : kUnconfirmed) * covariance;
  const double shared = options.drift * T_to_from.t.norm();  // m
  const double turned = shared / distance;                   // rad
  C.topLeftCorner<3, 3>().diagonal().array() += shared * shared + 1e-8;
  C.bottomRightCorner<3, 3>().diagonal().array() += turned * turned + 1e-10;
  graph.motion({from, to, T_to_from, C});
}

TrackResult SequenceLocator::Impl::track(const LocatorFrame& frame, const Located& located) {
  View view;
  TrackFrame next{frame.time, frame.image, {}, frame.mask};
  if (located.converged()) {
    view = locator.view(camera, located.T_WC);
    if (shown(view) >= kLeastShown * static_cast<double>(view.depth.size())) next.depth = view.depth_image();
    distance = mean_depth(view);
  }
  return tracker.track(next);
}

int SequenceLocator::Impl::frame_at(double time) const {
  return static_cast<int>(
      std::lower_bound(frames.begin(), frames.end(), time, [](const SequencePose& f, double t) { return f.time < t; }) -
      frames.begin());
}

/// Adds the motion to the newest frame.
void SequenceLocator::Impl::connect(const TrackResult& result) {
  const int now = graph.size() - 1;
  if (result.before) frame_of_keyframe[result.before->keyframe] = frame_at(result.before->time);
  if (result.status == TrackStatus::lost) return;
  if (result.status == TrackStatus::keyframe) {
    frame_of_keyframe[result.keyframe] = now;
    if (!result.origin) return;
    const TrackResult::Origin& origin = *result.origin;
    const SE3 T = tracker.keyframe_pose(result.keyframe).inverse() * tracker.keyframe_pose(origin.keyframe);
    add_motion(frame_of_keyframe.at(origin.keyframe), now, T, origin.covariance, origin.confirmed);
    return;
  }
  add_motion(frame_of_keyframe.at(result.keyframe), now, result.T_CK, result.covariance, result.confirmed);
}

/// Drops a pose on the map that the motion contradicts. Returns whether it did.
bool SequenceLocator::Impl::drop(int frame, Located& located) {
  if (!located.converged() || graph.surprise(frame) <= options.contradiction) return false;
  located.status = Status::diverged;
  located.reason = "the motion between frames contradicts the pose on the map";
  graph.trust(frame, false);
  return true;
}

SequencePose SequenceLocator::Impl::locate(const LocatorFrame& frame) {
  if (frame.prior) prior = frame.prior;
  const bool follows = graph.size() > 0 && graph.known(graph.size() - 1);
  std::optional<LocatePrior> where = follows || !frame.prior ? predicted(frame.time) : frame.prior;
  if (!where) where = prior;
  if (!where) throw Error(ErrorCode::invalid_argument, "the first frame of a sequence needs a prior");
  SequencePose pose;
  pose.time = frame.time;
  pose.located = locator.locate(frame.image, camera, *where, frame.mask);
  const TrackResult motion = track(frame, pose.located);  // may throw: the graph changes afterwards
  const int now = graph.add();
  connect(motion);
  graph.solve(graph.anchored_before(options.anchors), now);
  if (!pose.located.converged() && graph.known(now)) {
    const LocatePrior second = around(now);
    if ((second.T_WC.t - where->T_WC.t).norm() > where->position_sigma ||
        (second.T_WC.R.transpose() * where->T_WC.R).trace() < 2.99)
      pose.located = locator.locate(frame.image, camera, second, frame.mask);
  }
  if (pose.located.converged()) {
    graph.anchor(now, pose.located.T_WC, pose.located.covariance);
    graph.solve(graph.anchored_before(options.anchors), now);
    if (drop(now, pose.located)) graph.solve(graph.anchored_before(options.anchors), now);
  }
  pose.known = graph.known(now);
  frames.push_back(pose);
  if (pose.known) frames.back().T_WC = graph.pose(now), frames.back().covariance = covariance(now);
  return frames.back();
}

SequenceLocator::SequenceLocator(Locator& locator, const Camera& camera, const SequenceLocatorOptions& options) {
  options.check();
  impl_ = std::make_unique<Impl>(locator, camera, options);
}
SequenceLocator::~SequenceLocator() = default;

SequencePose SequenceLocator::locate(const LocatorFrame& frame) { return impl_->locate(frame); }

std::vector<SequencePose> SequenceLocator::all() {
  Impl& s = *impl_;
  s.graph.solve(0, s.graph.size());
  for (int i = 0; i < s.graph.size(); ++i) s.drop(i, s.frames[static_cast<size_t>(i)].located);
  s.graph.solve(0, 0);
  for (int i = 0; i < s.graph.size(); ++i) {
    SequencePose& pose = s.frames[static_cast<size_t>(i)];
    pose.known = s.graph.known(i);
    if (pose.known) pose.T_WC = s.graph.pose(i), pose.covariance = s.covariance(i);
  }
  return s.frames;
}

}  // namespace iclk
