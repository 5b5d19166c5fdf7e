#include "apps/iclk/session/report.h"

#include <cmath>
#include <map>

#include <iclk/session/feature_report.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>
#include <iclk/session/pose_errors.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/version.h"
#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

Matrix6d covariance_or_nan(const RefinedAlignment& result) {
  return has_covariance(result) ? result.covariance : Matrix6d::Constant(NAN);
}

Json camera_json(const Camera& c) {
  return {{"fx", c.fx}, {"fy", c.fy}, {"cx", c.cx}, {"cy", c.cy}, {"width", c.width}, {"height", c.height}};
}

/// Single precision, in as many digits as it has.
Json grey_weights(const RefinedAlignment& result) {
  Json weights;
  for (const double w : result.recolouring.weights) weights.push_back(std::round(1e6 * w) / 1e6);
  return weights;
}

Json stages(const PairInput& pair, const RefinedAlignment& result) {
  Json list = Json::array();
  for (const Stage& stage : result.stages) {
    Json entry = {{"name", stage.name},
                  {"T_10", matrix_json(stage.T_10.matrix())},
                  {"cost", number(stage.cost)},
                  {"ms", number(stage.ms)}};
    if (pair.truth) {
      const PoseError e = stage_error(pair, result, stage);
      entry["e_pixel"] = number(e.e_pixel);
      entry["e_transl"] = number(e.e_transl);
      entry["e_rot"] = number(e.e_rot);
    }
    list.push_back(std::move(entry));
  }
  return list;
}

Json levels(const Alignment& alignment) {
  Json list = Json::array();
  for (const LevelTrace& level : alignment.levels) {
    Json iterations = Json::array();
    for (const IterationTrace& i : level.iterations)
      iterations.push_back({{"cost", number(i.cost)},
                            {"visible", number(i.visible)},
                            {"step", number(i.step)},
                            {"lambda", number(i.lambda)},
                            {"accepted", i.accepted}});
    list.push_back({{"level", level.level}, {"scale", number(level.scale)}, {"iterations", std::move(iterations)}});
  }
  return list;
}

Json features(const PairInput& pair, const RefinedAlignment& result) {
  Json list = Json::array();
  for (int i = 0; i < pair.features.size(); ++i) {
    const auto at = static_cast<size_t>(i);
    Eigen::Vector2d uv1(NAN, NAN);
    feature_position(pair.camera, pair.features, result, i, uv1);
    const double q = at < result.inverse_depth.size() ? result.inverse_depth[at] : pair.features.inverse_depth[at];
    list.push_back({{"u0", number(pair.features.uv[at].x())},
                    {"v0", number(pair.features.uv[at].y())},
                    {"inverse_depth", number(q)},
                    {"u1", number(uv1.x())},
                    {"v1", number(uv1.y())},
                    {"status", feature_status(pair.camera, pair.features, result, i)}});
    if (at < result.features.size()) {
      const AlignedFeature& f = result.features[at];
      const bool aligned = f.status == FeatureStatus::aligned;
      list.back()["covariance"] = matrix_json(aligned ? f.covariance : Eigen::Matrix2d::Constant(NAN));
    }
    if (at < result.inverse_depth_sigma.size()) {
      const double sigma = result.inverse_depth_sigma[at];
      list.back()["inverse_depth_sigma"] = number(sigma > 0 ? sigma : NAN);
    }
  }
  return list;
}

std::string feature_line(const PairInput& pair, const RefinedAlignment& result) {
  std::map<std::string, int> counts;
  for (int i = 0; i < pair.features.size(); ++i) ++counts[feature_status(pair.camera, pair.features, result, i)];
  const std::string good = result.features.empty() ? "projected" : "aligned";
  std::string text = formatted("%d of %d %s", counts[good], pair.features.size(), good.c_str());
  for (const auto& [status, count] : counts)
    if (status != good && count > 0) text += formatted(", %d %s", count, status.c_str());
  return text;
}

}  // namespace

PoseError stage_error(const PairInput& pair, const RefinedAlignment& result, const Stage& stage) {
  PoseError error = pose_error(pair.camera, pair.features, stage.T_10, *pair.truth);
  if (stage.name == "feature_alignment")
    error.e_pixel = aligned_error(pair.camera, pair.features, result.features, *pair.truth);
  return error;
}

std::string hint(Status status, bool feature_file) {
  switch (status) {
    case Status::converged: return "";
    case Status::max_iterations: return "the pose was still moving: try --set damping=adaptive, or a closer --initial-pose";
    case Status::low_overlap: return "the target sees too little of the reference: use a closer frame, or give --initial-pose";
    case Status::degenerate:
      if (feature_file)
        return "the images do not determine the pose: give more features, on texture and all over the image; if the texture "
               "repeats, give --initial-pose";
      return "the images do not determine the pose: they need texture and depth all over the image; try --count 400 or "
             "--set detector=grid; if the texture repeats, give --initial-pose";
    case Status::too_few_features:
      if (feature_file)
        return "too few usable features: they must lie inside the reference, on texture, and have a depth; give more";
      return "too few usable features: check that --depth belongs to this reference and that --depth-scale is right; or try "
             "--count 400 or --set detector=grid";
    case Status::diverged:
      return "the images do not agree: check that they show the same place, and that --camera and --depth-scale are right; or "
             "give --initial-pose, or a closer frame";
    case Status::ambiguous:
      return "another pose explains the images just as well: hide moving objects, and all that is fixed to the camera, with "
             "--mask; if the texture repeats, give --initial-pose";
  }
  return "";
}

namespace {

/// The models that were asked, in turn.
Json attempts(const RefinedAlignment& result) {
  Json list = Json::array();
  for (const Attempt& a : result.attempts)
    list.push_back({{"model", a.model}, {"status", name(a.status)}, {"reason", a.reason}});
  return list;
}

Json rivals(const RefinedAlignment& result) {
  Json list = Json::array();
  for (const Rival& r : result.rivals) list.push_back({{"T_10", matrix_json(r.T_10.matrix())}, {"inliers", r.inliers}});
  return list;
}

std::string model_line(const RefinedAlignment& result) {
  std::string before;
  for (size_t i = 0; i + 1 < result.attempts.size(); ++i)
    before += (i == 0 ? " (" : ", ") + result.attempts[i].model + " " + name(result.attempts[i].status);
  return result.model + (before.empty() ? "" : before + ")");
}

Json blur(const RefinedAlignment& result) {
  if (!result.blur) return nullptr;
  const auto& [reference, target] = *result.blur;
  return {{reference.x(), reference.y()}, {target.x(), target.y()}};
}

}  // namespace

nlohmann::ordered_json to_json(const PairInput& pair, const RefinedAlignment& result, const Session& session) {
  const Cascade::Times& t = session.times();
  Json timing = {
      {"load", number(pair.load_ms)}, {"detect", number(pair.detect_ms)},
      {"setup", number(t.setup)},     {"prepare", number(t.prepare)},
      {"align", number(t.align)},     {"total", number(pair.load_ms + pair.detect_ms + t.setup + t.prepare + t.align)}};
  return {{"schema", kResultSchema},
          {"version", version()},
          {"status", name(result.status)},
          {"reason", result.reason},
          {"refined", result.refined},
          {"grey_weights", grey_weights(result)},
          {"T_10", matrix_json(result.T_10.matrix())},
          {"covariance", matrix_json(covariance_or_nan(result))},
          {"turn", result.turn ? Json{result.turn->x(), result.turn->y(), result.turn->z()} : Json(nullptr)},
          {"blur", blur(result)},
          {"rivals", rivals(result)},
          {"static_overlay", std::count(result.fixed.begin(), result.fixed.end(), true)},
          {"stages", stages(pair, result)},
          {"levels", levels(result.iclk)},
          {"features", features(pair, result)},
          {"camera", camera_json(pair.camera)},
          {"gain", number(result.iclk.gain)},
          {"bias", number(result.iclk.bias)},
          {"visible_fraction", number(result.iclk.visible_fraction)},
          {"correlation", number(result.iclk.correlation)},
          {"agreement", number(result.iclk.agreement)},
          {"model", result.model},
          {"attempts", attempts(result)},
          {"device", session.device_name()},
          {"timing_ms", std::move(timing)}};
}

std::string to_table(const PairInput& pair, const RefinedAlignment& result, const Session& session) {
  const Camera& c = pair.camera;
  std::string out;
  out += "reference  " + pair.name_0 + "\n" + "target     " + pair.name_1 + "\n";
  out += formatted("camera     %dx%d, fx %.2f fy %.2f cx %.2f cy %.2f\n", c.width, c.height, c.fx, c.fy, c.cx, c.cy);
  out += "model      " + printable(model_line(result)) + "\n";
  out += "device     " + session.device_name() + "\n";
  out += formatted("set-up     %.0f ms: kernels and memory, once for all pairs\n\n", session.times().setup);
  const auto row = [&](const std::string& stage, const PoseError* e, double cost, double ms) {
    out += formatted("%-18s", stage.c_str());
    if (e != nullptr) {
      out += std::isfinite(e->e_pixel) ? formatted(" %12.3f", e->e_pixel) : formatted(" %12s", "-");
      out += formatted(" %14.2f %12.4f", 1e3 * e->e_transl, e->e_rot / kDegree);
    }
    out += std::isfinite(cost) ? formatted(" %12.3g", cost) : formatted(" %12s", "");
    out += std::isfinite(ms) ? formatted(" %9.2f\n", ms) : "\n";
  };
  out += formatted("%-18s", "stage");
  if (pair.truth) out += formatted(" %12s %14s %12s", "error [px]", "transl. [mm]", "rot. [deg]");
  out += formatted(" %12s %9s\n", "cost", "ms");
  if (pair.truth) {
    const PoseError start = pose_error(c, pair.features, pair.start(), *pair.truth);
    row("(first guess)", &start, NAN, NAN);
  }
  for (const Stage& stage : result.stages) {
    if (!pair.truth) {
      row(stage.name, nullptr, stage.cost, stage.ms);
      continue;
    }
    const PoseError e = stage_error(pair, result, stage);
    row(stage.name, &e, stage.cost, stage.ms);
  }
  out += "\nfeatures   " + feature_line(pair, result) + "\n";
  out += formatted("visible    %.0f %% of the pixels used fall into the target\n", 100 * result.iclk.visible_fraction);
  if (result.turn)
    out +=
        formatted("shutter    rolling: corrected for %.2f deg of rotation during the readout\n", result.turn->norm() / kDegree);
  if (result.blur)
    out += formatted("blur       reference %.0f px, target %.0f px: both images were blurred alike\n",
                     result.blur->reference.norm(), result.blur->target.norm());
  if (const auto fixed = std::count(result.fixed.begin(), result.fixed.end(), true); fixed > 0)
    out += formatted("overlay    %d features are fixed to the camera\n", static_cast<int>(fixed));
  for (const Rival& r : result.rivals)
    out += formatted("rival      %d features agree on the pose %s\n", r.inliers, tum_line(r.T_10).c_str());
  out += "T_10       tx ty tz [m] qx qy qz qw, camera 0 to camera 1:\n           " + tum_line(result.T_10) + "\n";
  out += formatted("motion     %.1f mm, %.3f deg", 1e3 * result.T_10.t.norm(), result.T_10.angle() / kDegree);
  if (has_covariance(result)) {
    const Eigen::Matrix<double, 6, 1> sigma = result.covariance.diagonal().cwiseSqrt();
    out += formatted("; 1 sigma %.2f mm, %.4f deg", 1e3 * sigma.head<3>().norm(), sigma.tail<3>().norm() / kDegree);
  }
  out += formatted("\nstatus     %s: %s\n", name(result.status), result.reason.c_str());
  if (const std::string advice = hint(result.status, pair.features_from_file); !advice.empty())
    out += "hint       " + advice + "\n";
  return out;
}

}  // namespace iclk
