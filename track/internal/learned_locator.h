#pragma once
#include <memory>
#include <optional>

#include <iclk/session/session.h>
#include <iclk/track/internal/judge.h>

namespace iclk::internal {

/// Places frames with the later models of a session, which cost several times as much as the first. They are loaded for the
/// first frame that needs them.
class LearnedLocator {
 public:
  /// `options`: those of the session, without its first model. `context`: its device.
  LearnedLocator(const Camera& camera, const Judge& judge, SessionOptions options, std::shared_ptr<engine::Context> context);

  /// Aligns with a keyframe, from the expected pose and by a search. The pose is confirmed; or credible, if the expected pose
  /// is `recent`.
  std::optional<Found> find(const TrackFrame& frame, const Keyframe& k, const SE3& expected, bool recent);

 private:
  Camera camera_;
  Judge judge_;
  SessionOptions options_;
  std::shared_ptr<engine::Context> context_;
  std::unique_ptr<Session> session_;
};

}  // namespace iclk::internal
