#include "python/results.h"

#include <algorithm>
#include <cmath>

#include <nanobind/stl/string.h>

#include <iclk/session/feature_report.h>

#include "python/arrays.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

/// Positions in the target and what is known of them, a feature each.
void add_features(const RefinedAlignment& result, const Reference& reference, nb::dict& out) {
  const auto count = static_cast<size_t>(reference.features.size());
  std::vector<double> uv(2 * count, NAN), covariance(4 * count, NAN), inverse_depth = reference.features.inverse_depth;
  nb::list status;
  for (size_t i = 0; i < count; ++i) {
    const int index = static_cast<int>(i);
    Eigen::Vector2d at(NAN, NAN);
    if (feature_position(reference.camera, reference.features, result, index, at)) {
      uv[2 * i] = at.x();
      uv[2 * i + 1] = at.y();
    }
    if (i < result.features.size() && result.features[i].status == FeatureStatus::aligned)
      std::copy_n(result.features[i].covariance.data(), 4, covariance.begin() + static_cast<std::ptrdiff_t>(4 * i));
    if (i < result.inverse_depth.size()) inverse_depth[i] = result.inverse_depth[i];
    status.append(nb::str(feature_status(reference.camera, reference.features, result, index).c_str()));
  }
  out["uv"] = to_array(uv.data(), {count, 2});
  out["uv_covariance"] = to_array(covariance.data(), {count, 2, 2});
  out["feature_status"] = nb::tuple(status);
  out["inverse_depth"] = to_array(inverse_depth);
  std::vector<double> sigma(count, NAN);
  for (size_t i = 0; i < count && i < result.inverse_depth_sigma.size(); ++i)
    if (result.inverse_depth_sigma[i] > 0) sigma[i] = result.inverse_depth_sigma[i];
  out["inverse_depth_sigma"] = to_array(sigma);
}

}  // namespace

Fields to_dict(const RefinedAlignment& result, const Reference& reference) {
  Fields out;
  out["status"] = name(result.status);
  out["reason"] = result.reason;
  out["T_10"] = to_array(result.T_10);
  out["covariance"] = to_array(has_covariance(result) ? result.covariance : Matrix6d::Constant(NAN));
  out["refined"] = result.refined;
  out["turn"] = result.turn ? nb::cast(to_array(result.turn->data(), {3})) : nb::none();
  out["blur"] = nb::none();
  if (result.blur) {
    Eigen::Matrix2d lines;  // column-major
    lines << result.blur->reference, result.blur->target;
    out["blur"] = nb::cast(to_array(lines.data(), {2, 2}));
  }
  add_features(result, reference, out);
  out["gain"] = result.iclk.gain;
  out["bias"] = result.iclk.bias;
  out["visible_fraction"] = result.iclk.visible_fraction;
  out["correlation"] = result.iclk.correlation;
  out["agreement"] = result.iclk.agreement;
  out["inliers"] = result.inliers;
  out["sigma"] = result.sigma;
  out["model"] = result.model;
  nb::list attempts, stages, rivals;
  for (const Attempt& a : result.attempts) attempts.append(nb::make_tuple(a.model, name(a.status), a.reason));
  for (const Stage& s : result.stages) stages.append(nb::make_tuple(s.name, to_array(s.T_10), s.cost, s.ms));
  for (const Rival& r : result.rivals) rivals.append(nb::make_tuple(to_array(r.T_10), r.inliers));
  out["rivals"] = rivals;
  out["static_overlay"] = std::count(result.fixed.begin(), result.fixed.end(), true);
  out["attempts"] = attempts;
  out["stages"] = stages;
  return out;
}

}  // namespace iclk::python
