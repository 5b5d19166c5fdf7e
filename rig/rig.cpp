#include <iclk/rig/rig.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <sstream>

#include <Eigen/Cholesky>

#include <iclk/align/common/options_check.h>
#include <iclk/engine/error.h>
#include <iclk/rig/internal/common_pose.h>

namespace iclk {
namespace {

constexpr double kLeastAgree = 0.25;  // of the pairs
constexpr double kMostStretch = 2;    // of a baseline, by a shock

Matrix6d diagonal(double translation, double rotation) {
  Matrix6d C = Matrix6d::Zero();
  C.diagonal() << Eigen::Vector3d::Constant(translation * translation), Eigen::Vector3d::Constant(rotation * rotation);
  return C;
}

/// Mean of |rectified_error|, px.
double epipolar(const Camera& camera, std::span<const RigSighting> sightings, const SE3& T_rl) {
  double sum = 0;
  int count = 0;
  for (const RigSighting& s : sightings) {
    const double e = std::abs(rectified_error(camera, camera, T_rl, s.left, s.right));
    if (!std::isfinite(e)) continue;
    sum += e;
    ++count;
  }
  return count ? sum / count : 0;
}

std::vector<RigSighting> sightings_of(int pair, const Features& features, const RefinedAlignment& r,
                                      const RigOptions& options) {
  std::vector<RigSighting> out;
  for (size_t k = 0; k < r.features.size(); ++k) {
    if (r.features[k].status != FeatureStatus::aligned) continue;
    const double q = features.inverse_depth[k];
    double sigma = 0;
    if (options.metric) {
      sigma = features.inverse_depth_sigma.empty() ? 0 : features.inverse_depth_sigma[k];
      if (!(sigma > 0) || !std::isfinite(sigma)) sigma = options.depth_sigma * q;
    }
    out.push_back({pair, features.uv[k], r.features[k].uv1, r.features[k].covariance, q, sigma});
  }
  return out;
}

/// A pair's own pose, or ICLK's where the features do not confirm it. What a vote can be worth is bounded by `floor`: errors of
/// a scene and of depths are not in its covariance.
bool vote_of(const RefinedAlignment& r, const Matrix6d& floor, internal::PoseVote& vote) {
  vote.T = r.T_10;
  if (usable(r.status) && r.covariance.diagonal().minCoeff() > 0)
    vote.covariance = r.covariance + floor;
  else if (usable(r.iclk.status) && r.iclk.covariance.diagonal().minCoeff() > 0)
    vote.covariance = 9 * r.iclk.covariance + 9 * floor;
  else
    return false;
  return vote.T.R.allFinite() && vote.T.t.allFinite() && vote.covariance.allFinite();
}

std::unique_ptr<Aligner> aligner_for(const Session& session, const Camera& camera, std::span<const RigPair> pairs) {
  if (pairs.empty()) throw Error(ErrorCode::invalid_argument, "rig: no pairs");
  int features = 1;
  bool masks = false;
  for (const RigPair& pair : pairs) {
    features = std::max(features, pair.features.size());
    masks = masks || !pair.right_mask.empty();
  }
  const int batch = std::min(session.options().batch, static_cast<int>(pairs.size()));
  return session.make_aligner(rig_plan(camera, features, batch, masks));
}

std::string failure(std::span<const RigPairReport> pairs) {
  std::ostringstream why;
  why << "none of " << pairs.size() << " pairs could be aligned";
  if (!pairs.empty()) why << "; the first: " << pairs.front().reason;
  return why.str();
}

}  // namespace

void RigOptions::check() const {
  check_range("rig depth_sigma", depth_sigma, 1e-9, 10);
  check_range("rig baseline_sigma", baseline_sigma, 1e-9, 1);
  check_range("rig rounds", rounds, 1, 20);
  check_range("rig max_distance", max_distance, 1, 1e9);
  check_range("rig calibration_rotation", calibration_rotation, 0, 1);
  check_range("rig calibration_translation", calibration_translation, 0, 1);
  check_range("rig false_alarm", false_alarm, 1e-9, 0.5);
  refiner.check();
  adjust.check();
}

double chi_square_quantile(int freedom, double p) {
  check_range("degrees of freedom", freedom, 1, 1e9);
  check_range("probability", p, 1e-12, 1 - 1e-12);
  // The normal quantile by bisection of erfc: exact, and asked for once.
  double low = -8, high = 8;
  for (int i = 0; i < 80; ++i) {
    const double z = 0.5 * (low + high);
    (0.5 * std::erfc(z / std::numbers::sqrt2) > p ? low : high) = z;
  }
  const double a = 2.0 / (9 * freedom);
  return freedom * std::pow(1 - a + 0.5 * (low + high) * std::sqrt(a), 3);
}

Plan rig_plan(const Camera& camera, int max_features, int max_pairs, bool masks) {
  Plan plan;
  plan.width = camera.width;
  plan.height = camera.height;
  plan.max_features = max_features;
  plan.max_references = plan.max_pairs = max_pairs;
  plan.target_masks = masks;
  return plan;
}

std::vector<RefinedAlignment> align_pairs(const Session& session, const Camera& camera, std::span<const RigPair> pairs,
                                          const SE3& T_rl, const RefinerOptions& options, bool search) {
  return align_pairs(*aligner_for(session, camera, pairs), camera, pairs, T_rl, options, search);
}

RigResult estimate_rig(const Session& session, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl,
                       const RigOptions& options) {
  return estimate_rig(*aligner_for(session, camera, pairs), camera, pairs, T_rl, options);
}

std::vector<RefinedAlignment> align_pairs(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs,
                                          const SE3& T_rl, const RefinerOptions& options, bool search) {
  RefinerOptions global = options;
  global.rolling_shutter = false;  // both cameras turn alike: what bends an image is an error, and has to show
  Refiner refiner(aligner, global);
  const auto batch = static_cast<size_t>(std::max(1, std::min(aligner.plan().max_references, aligner.plan().max_pairs)));
  std::vector<RefinedAlignment> results;
  for (size_t first = 0; first < pairs.size(); first += batch) {
    const std::span<const RigPair> part = pairs.subspan(first, std::min(batch, pairs.size() - first));
    std::vector<Pair> tasks;
    for (const RigPair& p : part) {
      const int slot = static_cast<int>(tasks.size());
      aligner.set_reference(slot, {p.left, camera, p.features, {}});
      tasks.push_back({slot, p.right, T_rl, std::nullopt, search, p.right_mask});
    }
    for (RefinedAlignment& r : refiner.align(tasks)) results.push_back(std::move(r));
  }
  return results;
}

RigResult estimate_rig(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl,
                       const RigOptions& options) {
  options.check();
  camera.check();
  if (pairs.empty()) throw Error(ErrorCode::invalid_argument, "rig: no pairs");
  const double baseline = T_rl.t.norm();
  if (!T_rl.R.allFinite() || !(baseline > 0) || !std::isfinite(baseline))
    throw Error(ErrorCode::invalid_argument, "rig: T_rl of the old calibration is not finite or has no baseline");

  RigResult result;
  result.T_rl = T_rl;
  result.scale_from_prior = !options.metric;
  result.pairs.resize(pairs.size());
  // 0.01 degrees and a thousandth of the baseline.
  const Matrix6d floor = diagonal(1e-3 * baseline, 1.7e-4);
  SE3 common = T_rl;
  std::vector<RefinedAlignment> aligned;
  for (int round = 0; round < options.rounds; ++round) {
    aligned = align_pairs(aligner, camera, pairs, common, options.refiner, options.search && round == 0);
    std::vector<internal::PoseVote> votes;
    std::vector<size_t> of;
    for (size_t i = 0; i < pairs.size(); ++i) {
      RigPairReport& report = result.pairs[i];
      report.T_rl = aligned[i].T_10;
      report.covariance = aligned[i].covariance;
      report.status = aligned[i].status;
      report.reason = aligned[i].reason;
      report.used = false;
      internal::PoseVote vote;
      if (!vote_of(aligned[i], floor, vote)) continue;
      votes.push_back(vote);
      of.push_back(i);
    }
    if (votes.empty()) {
      result.reason = failure(result.pairs);
      return result;
    }
    common = internal::common_pose(votes);
    for (size_t k = 0; k < votes.size(); ++k) {
      RigPairReport& report = result.pairs[of[k]];
      report.distance = votes[k].distance;
      report.used = votes[k].distance <= options.max_distance;
    }
  }

  const auto agree = std::count_if(result.pairs.begin(), result.pairs.end(), [](const auto& p) { return p.used; });
  if (static_cast<double>(agree) < kLeastAgree * static_cast<double>(pairs.size())) {
    result.reason = std::to_string(agree) + " of " + std::to_string(pairs.size()) +
                    " pairs agree on one pose, too few: are left and right images in the same order?";
    return result;
  }
  std::vector<std::vector<RigSighting>> by_pair(pairs.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    by_pair[i] = sightings_of(static_cast<int>(i), pairs[i].features, aligned[i], options);
    RigPairReport& report = result.pairs[i];
    report.sightings = static_cast<int>(by_pair[i].size());
    report.used = report.used && report.sightings > 0;
    if (!report.used) continue;
    ++result.pairs_used;
    result.found.insert(result.found.end(), by_pair[i].begin(), by_pair[i].end());
  }
  result.sightings = static_cast<int>(result.found.size());
  RigAdjustOptions adjust = options.adjust;
  adjust.baseline = baseline;
  adjust.baseline_sigma = options.metric ? 0 : options.baseline_sigma * baseline;
  const RigAdjustment joint = adjust_rig(camera, camera, result.found, common, adjust);
  result.inliers = joint.inliers;
  result.sigma = joint.sigma;
  result.inflation = joint.inflation;
  if (!joint.usable || 2 * joint.inliers < joint.used) {
    std::ostringstream why;
    why << joint.inliers << " of " << joint.used << " features of " << result.pairs_used << " pairs agree on one pose";
    if (2 * joint.inliers >= joint.used) why << ", which they do not determine";
    result.reason = why.str();
    return result;
  }
  const double found = joint.T_rl.t.norm();
  if (options.metric && !(found > baseline / kMostStretch && found < kMostStretch * baseline)) {
    std::ostringstream why;
    why << "the images say a baseline of " << found << " m, the calibration " << baseline
        << " m: are left and right of two cameras, and depths and calibration in metres?";
    result.reason = why.str();
    return result;
  }
  result.usable = true;
  result.T_rl = joint.T_rl;
  result.covariance = joint.covariance;
  for (size_t i = 0; i < result.found.size(); ++i) result.found[i].inverse_depth = joint.inverse_depth[i];
  result.epipolar_before = epipolar(camera, result.found, T_rl);
  result.epipolar_after = epipolar(camera, result.found, result.T_rl);
  for (size_t i = 0; i < pairs.size(); ++i) {
    result.pairs[i].epipolar_before = epipolar(camera, by_pair[i], T_rl);
    result.pairs[i].epipolar_after = epipolar(camera, by_pair[i], result.T_rl);
  }
  const Vector6d moved = (T_rl.inverse() * result.T_rl).log();
  const Matrix6d C = result.covariance + diagonal(options.calibration_translation * baseline, options.calibration_rotation);
  result.chi_square = moved.dot(C.ldlt().solve(moved));
  result.threshold = chi_square_quantile(6, options.false_alarm);
  result.moved = result.chi_square > result.threshold;
  std::ostringstream words;
  words << result.inliers << " of " << result.sightings << " features of " << result.pairs_used << " of " << pairs.size()
        << " pairs agree within " << options.adjust.inlier_distance << " px";
  if (result.scale_from_prior) words << "; scale from prior";
  result.reason = words.str();
  return result;
}

}  // namespace iclk
