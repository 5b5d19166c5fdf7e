#include <iclk/session/feature_report.h>

#include <iclk/session/pose_errors.h>

namespace iclk {

bool has_covariance(const RefinedAlignment& result) {
  return usable(result.status) && (result.covariance.diagonal().array() > 0).all();
}

std::string feature_status(const Camera& camera, const Features& features, const RefinedAlignment& result, int i) {
  const auto at = static_cast<size_t>(i);
  if (at < result.iclk.features.size() && result.iclk.features[at] != FeatureCheck::ok) return name(result.iclk.features[at]);
  if (at < result.features.size()) return name(result.features[at].status);
  Eigen::Vector2d uv1;
  const bool inside = project_feature(camera, features, i, result.T_10, uv1) && camera.contains(uv1);
  return inside ? "projected" : "out_of_image";
}

bool feature_position(const Camera& camera, const Features& features, const RefinedAlignment& result, int i,
                      Eigen::Vector2d& uv1) {
  const auto at = static_cast<size_t>(i);
  if (at < result.features.size() && result.features[at].status == FeatureStatus::aligned) {
    uv1 = result.features[at].uv1;
    return uv1.allFinite();
  }
  return project_feature(camera, features, i, result.T_10, uv1);
}

}  // namespace iclk
