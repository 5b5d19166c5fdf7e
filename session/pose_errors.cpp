#include <iclk/session/pose_errors.h>

#include <cmath>
#include <limits>

namespace iclk {

bool project_feature(const Camera& camera, const Features& features, int i, const SE3& T_10, Eigen::Vector2d& uv1) {
  const auto at = static_cast<size_t>(i);
  const double q = features.inverse_depth[at];
  if (!features.uv[at].allFinite() || !std::isfinite(q) || q <= 0) return false;
  const Eigen::Vector3d X1 = T_10 * Eigen::Vector3d(camera.ray(features.uv[at]) / q);
  if (!(X1.z() > 0) || !X1.allFinite()) return false;
  uv1 = camera.project(X1);
  return uv1.allFinite();
}

PoseError pose_error(const Camera& camera, const Features& features, const SE3& T_10, const SE3& T_10_true) {
  double sum = 0;
  int count = 0;
  for (int i = 0; i < features.size(); ++i) {
    Eigen::Vector2d estimated, truth;
    if (!project_feature(camera, features, i, T_10, estimated) || !project_feature(camera, features, i, T_10_true, truth))
      continue;
    sum += (estimated - truth).norm();
    ++count;
  }
  PoseError error;
  error.e_pixel = count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
  error.e_transl = (T_10.t - T_10_true.t).norm();
  error.e_rot = (T_10 * T_10_true.inverse()).angle();
  return error;
}

double aligned_error(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                     const SE3& T_10_true) {
  double sum = 0;
  int count = 0;
  for (int i = 0; i < features.size() && i < static_cast<int>(aligned.size()); ++i) {
    const AlignedFeature& a = aligned[static_cast<size_t>(i)];
    Eigen::Vector2d truth;
    if (a.status != FeatureStatus::aligned || !project_feature(camera, features, i, T_10_true, truth)) continue;
    sum += (a.uv1 - truth).norm();
    ++count;
  }
  return count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace iclk
