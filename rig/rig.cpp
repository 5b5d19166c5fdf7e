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

constexpr double kLeastAgree = 0.25;  // least share of pairs that agree
constexpr double kMostStretch = 2;    // largest factor by which a shock changes the baseline

Matrix6d diagonal(double translation, double rotation) {
  Matrix6d C = Matrix6d::Zero();
  C.diagonal() << Eigen::Vector3d::Constant(translation * translation), Eigen::Vector3d::Constant(rotation * rotation);
  return C;
}

/// The mean of |rectified_error()|, px.
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

/// The pose of a pair, or that of ICLK if the features do not confirm it. `floor` bounds the weight of a vote, because its
/// covariance does not include errors of the scene and of depths.
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
  if (pairs.empty()) throw Error(ErrorCode::invalid_argument, "rig: no pairs given");
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

/// The steps of estimate_rig(). A step that fails sets the reason of the result.
class Estimation {
 public:
  Estimation(Aligner& aligner, const Camera& camera, std::span<const RigPair> pairs, const SE3& T_rl, const RigOptions& options)
      : aligner_(aligner), camera_(camera), pairs_(pairs), T_rl_(T_rl), options_(options), baseline_(T_rl.t.norm()) {
    result_.T_rl = T_rl;
    result_.scale_from_prior = !options.metric;
    result_.pairs.resize(pairs.size());
  }

  RigResult run() {
    if (!find_common_pose()) return result_;
    gather();
    if (!adjust()) return result_;
    compare_with_calibration();
    return result_;
  }

 private:
  /// Aligns the pairs separately, and then again from their common pose.
  bool find_common_pose() {
    common_ = T_rl_;
    for (int round = 0; round < options_.rounds; ++round) {
      aligned_ = align_pairs(aligner_, camera_, pairs_, common_, options_.refiner, options_.search && round == 0);
      if (!vote()) return false;
    }
    const auto agree = std::count_if(result_.pairs.begin(), result_.pairs.end(), [](const auto& p) { return p.used; });
    if (static_cast<double>(agree) >= kLeastAgree * static_cast<double>(pairs_.size())) return true;
    result_.reason = std::to_string(agree) + " of " + std::to_string(pairs_.size()) +
                     " pairs agree on one pose, which is too few: check that left and right images have the same order";
    return false;
  }

  bool vote() {
    const Matrix6d floor = diagonal(1e-3 * baseline_, 1.7e-4);  // a thousandth of the baseline, 0.01 degrees
    std::vector<internal::PoseVote> votes;
    std::vector<size_t> of;
    for (size_t i = 0; i < pairs_.size(); ++i) {
      const RefinedAlignment& a = aligned_[i];
      RigPairReport& report = result_.pairs[i];
      report.T_rl = a.T_10;
      report.covariance = a.covariance;
      report.status = a.status;
      report.reason = a.reason;
      report.used = false;
      internal::PoseVote vote;
      if (!vote_of(a, floor, vote)) continue;
      votes.push_back(vote);
      of.push_back(i);
    }
    if (votes.empty()) {
      result_.reason = failure(result_.pairs);
      return false;
    }
    common_ = internal::common_pose(votes);
    for (size_t k = 0; k < votes.size(); ++k) {
      RigPairReport& report = result_.pairs[of[k]];
      report.distance = votes[k].distance;
      report.used = votes[k].distance <= options_.max_distance;
    }
    return true;
  }

  /// Collects the sightings of the pairs that agree.
  void gather() {
    sightings_.resize(pairs_.size());
    for (size_t i = 0; i < pairs_.size(); ++i) {
      sightings_[i] = sightings_of(static_cast<int>(i), pairs_[i].features, aligned_[i], options_);
      RigPairReport& report = result_.pairs[i];
      report.sightings = static_cast<int>(sightings_[i].size());
      report.used = report.used && report.sightings > 0;
      if (!report.used) continue;
      ++result_.pairs_used;
      result_.found.insert(result_.found.end(), sightings_[i].begin(), sightings_[i].end());
    }
    result_.sightings = static_cast<int>(result_.found.size());
  }

  /// Adjusts pose and inverse depths together.
  bool adjust() {
    RigAdjustOptions options = options_.adjust;
    options.baseline = baseline_;
    options.baseline_sigma = options_.metric ? 0 : options_.baseline_sigma * baseline_;
    const RigAdjustment joint = adjust_rig(camera_, camera_, result_.found, common_, options);
    result_.inliers = joint.inliers;
    result_.sigma = joint.sigma;
    result_.inflation = joint.inflation;
    if (!credible(joint)) return false;
    result_.usable = true;
    result_.T_rl = joint.T_rl;
    result_.covariance = joint.covariance;
    for (size_t i = 0; i < result_.found.size(); ++i) result_.found[i].inverse_depth = joint.inverse_depth[i];
    return true;
  }

  bool credible(const RigAdjustment& joint) {
    std::ostringstream why;
    const double found = joint.T_rl.t.norm();
    if (!joint.usable || 2 * joint.inliers < joint.used) {
      why << joint.inliers << " of " << joint.used << " features of " << result_.pairs_used << " pairs agree on one pose";
      if (2 * joint.inliers >= joint.used) why << ", but they do not determine it";
    } else if (options_.metric && !(found > baseline_ / kMostStretch && found < kMostStretch * baseline_)) {
      why << "the images give a baseline of " << found << " m, the calibration " << baseline_
          << " m: check that left and right are two cameras, and that depths and calibration are in metres";
    }
    result_.reason = why.str();
    return result_.reason.empty();
  }

  void compare_with_calibration() {
    result_.epipolar_before = epipolar(camera_, result_.found, T_rl_);
    result_.epipolar_after = epipolar(camera_, result_.found, result_.T_rl);
    for (size_t i = 0; i < pairs_.size(); ++i) {
      result_.pairs[i].epipolar_before = epipolar(camera_, sightings_[i], T_rl_);
      result_.pairs[i].epipolar_after = epipolar(camera_, sightings_[i], result_.T_rl);
    }
    const Vector6d moved = (T_rl_.inverse() * result_.T_rl).log();
    const Matrix6d C =
        result_.covariance + diagonal(options_.calibration_translation * baseline_, options_.calibration_rotation);
    result_.chi_square = moved.dot(C.ldlt().solve(moved));
    result_.threshold = chi_square_quantile(6, options_.false_alarm);
    result_.moved = result_.chi_square > result_.threshold;
    std::ostringstream words;
    words << result_.inliers << " of " << result_.sightings << " features of " << result_.pairs_used << " of " << pairs_.size()
          << " pairs agree within " << options_.adjust.inlier_distance << " px";
    if (result_.scale_from_prior) words << "; scale from the old calibration";
    result_.reason = words.str();
  }

  Aligner& aligner_;
  const Camera& camera_;
  std::span<const RigPair> pairs_;
  const SE3& T_rl_;
  const RigOptions& options_;
  double baseline_;
  SE3 common_;
  std::vector<RefinedAlignment> aligned_;
  std::vector<std::vector<RigSighting>> sightings_;
  RigResult result_;
};

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
  // The normal quantile by bisection of erfc: exact, and computed only once.
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
  global.rolling_shutter = false;  // both cameras turn equally, so a bend is an error and must not be corrected
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
  if (pairs.empty()) throw Error(ErrorCode::invalid_argument, "rig: no pairs given");
  const double baseline = T_rl.t.norm();
  if (!T_rl.R.allFinite() || !(baseline > 0) || !std::isfinite(baseline))
    throw Error(ErrorCode::invalid_argument, "rig: T_rl of the old calibration is not finite or has no baseline");
  return Estimation(aligner, camera, pairs, T_rl, options).run();
}

}  // namespace iclk
