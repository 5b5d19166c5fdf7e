#include <iclk/refine/internal/rivals.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <iclk/align/search/matching.h>
#include <iclk/refine/internal/align_feature.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/shaders/refine/refine.h>

namespace iclk::internal {
namespace {

using Eigen::Vector2d;

constexpr int kNumbers = 4 * ICLK_MATCH_TEXELS;
constexpr size_t kBest = 2, kNear = 6;   // places of a feature: the most similar ones, and the nearest of equally similar ones
constexpr int kApart = 4;                // pixels of the map between two places
constexpr int kOwn = 3;                  // the same around the place that the answer explains
constexpr float kLeastScore = 0.5f;      // of a place
constexpr float kWorse = 0.2f;           // than the best place: not similar
constexpr float kClear = 0.8f;           // score of a place at which a feature is certainly visible,
constexpr float kClearlyBetter = 0.15f;  // and by which it must exceed the place of the answer
constexpr float kBetter = 0.05f;         // the same for a feature that may have moved there
constexpr int kSample = int{ICLK_ELSEWHERE_SAMPLE};      // features that are searched for first
constexpr double kExplained = ICLK_ELSEWHERE_EXPLAINED;  // explained share above which other poses are unlikely,
constexpr double kAlike = 0.15;                          // unless this share looks like another place
constexpr int kHypotheses = 512;
constexpr float kAsMuch = 0.1f;         // scores that differ by less are equal
constexpr double kLeastSupport = 0.35;  // least support of a pose that is aligned

using Scores = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Converts a pixel of the image to one of the match map.
Vector2d to_map(const Vector2d& uv, int scale) { return (uv.array() + 0.5) / scale - 0.5; }

/// The descriptor of the reference's patch, warped to the target.
MatchDescriptor describe_warped(const Map& map, const Vector2d& centre, const Eigen::Matrix2d& back) {
  std::array<float, ICLK_PATCH_AREA> patch;
  for (int p = 0; p < ICLK_PATCH_AREA; ++p) {
    const Vector2d at = centre + back * Vector2d(p % ICLK_PATCH - 3.5, p / ICLK_PATCH - 3.5);
    patch[static_cast<size_t>(p)] = static_cast<float>(map.bilinear(at.x(), at.y()));
  }
  return describe(patch);
}

/// The best places, except those around `own`.
std::vector<std::pair<float, Vector2d>> places_of(const Eigen::Ref<const Eigen::RowVectorXf>& scores, const MatchLayout& layout,
                                                  const Vector2d& own) {
  std::vector<std::pair<float, int>> cells;  // the best of each few pixels squared
  const float least = std::max(kLeastScore, scores.maxCoeff() - kWorse);
  for (int v0 = 0; v0 < layout.places_y; v0 += kApart) {
    const int rows = std::min(kApart, layout.places_y - v0);
    Eigen::RowVectorXf most = scores.segment(v0 * layout.places_x, layout.places_x);
    for (int v = v0 + 1; v < v0 + rows; ++v) most = most.cwiseMax(scores.segment(v * layout.places_x, layout.places_x));
    for (int u0 = 0; u0 < layout.places_x; u0 += kApart) {
      const int columns = std::min(kApart, layout.places_x - u0);
      if (!(most.segment(u0, columns).maxCoeff() > least)) continue;
      std::pair<float, int> best{least, -1};
      for (int v = v0; v < v0 + rows; ++v)
        for (int u = u0; u < u0 + columns; ++u)
          if (const int k = v * layout.places_x + u; scores[k] > best.first) best = {scores[k], k};
      cells.push_back(best);
    }
  }
  std::sort(cells.begin(), cells.end(), std::greater<>());
  std::vector<std::pair<float, Vector2d>> out;
  for (const auto& [score, k] : cells) {
    const Vector2d at(k % layout.places_x + 3.5, k / layout.places_x + 3.5);
    const auto near = [&](const Vector2d& p, double reach) { return (p - at).lpNorm<Eigen::Infinity>() <= reach; };
    if (near(own, kOwn) || std::any_of(out.begin(), out.end(), [&](const auto& p) { return near(p.second, kApart); })) continue;
    out.emplace_back(score, at);
  }
  if (out.size() > kBest + kNear) {  // a wall of tiles has hundreds
    const auto by_distance = [&](const auto& a, const auto& b) {
      return (a.second - own).squaredNorm() < (b.second - own).squaredNorm();
    };
    std::partial_sort(out.begin() + kBest, out.begin() + kBest + kNear, out.end(), by_distance);
    out.resize(kBest + kNear);
  }
  return out;
}

struct Sought {
  size_t feature;
  Vector2d own;  // the place of the answer, pixels of the map
  Eigen::Matrix<float, 1, kNumbers> descriptor;
};

/// The best score of the places near a pixel of the map.
float score_near(const Sought& sought, const PlaceDescriptors& places, const MatchLayout& layout, const Vector2d& at) {
  const auto u0 = static_cast<int>(std::lround(at.x() - 3.5)), v0 = static_cast<int>(std::lround(at.y() - 3.5));
  float best = -1;
  for (int v = std::max(v0 - 1, 0); v <= std::min(v0 + 1, layout.places_y - 1); ++v)
    for (int u = std::max(u0 - 1, 0); u <= std::min(u0 + 1, layout.places_x - 1); ++u)
      best = std::max(best, sought.descriptor.dot(places.col(v * layout.places_x + u)));
  return best;
}

/// The features in an order in which the first ones are a sample of all.
std::vector<Sought> seek(const Map& map0, const Camera& camera, const Features& features, std::span<const FeatureCheck> checks,
                         const SE3& T_10, const MatchLayout& layout) {
  std::vector<Sought> out;
  const int count = std::min(features.size(), layout.features), stride = std::max(count / kSample, 1);
  for (int offset = 0; offset < stride; ++offset)
    for (int match = offset; match < count; match += stride) {
      const auto i = static_cast<size_t>(matched_feature(match, features.size()));
      if (checks[i] != FeatureCheck::ok) continue;
      const PatchWarp warp = warp_patch(camera, features.uv[i], features.inverse_depth[i], T_10);
      if (!warp.valid) continue;
      const MatchDescriptor d = describe_warped(map0, to_map(features.uv[i], layout.scale), warp.A.inverse());
      out.push_back({i, to_map(warp.uv1, layout.scale), Eigen::Map<const Eigen::Matrix<float, 1, kNumbers>>(d.data())});
    }
  return out;
}

struct Candidates {
  std::vector<Correspondence> alike;  // places as similar as the best
  std::vector<Correspondence> moved;  // the best places of features that do not agree with the answer
};

/// Adds poses on which places of `from` agree. Places that one pose explains are left out for the next.
void propose(std::vector<Correspondence>& from, Candidates& all, const Camera& camera, double mean_q, const MatchLayout& layout,
             int most, std::vector<SE3>& poses) {
  std::stable_sort(from.begin(), from.end(), [](const auto& a, const auto& b) { return a.distinct > b.distinct; });
  for (int k = 0; k < most; ++k) {
    const auto pose = pose_of(from, camera, mean_q, layout, kHypotheses, 0);
    if (!pose) return;
    const SE3& T = pose->T_10;
    const auto explained = [&](const Correspondence& c) {
      const Eigen::Vector3d X = T.R * c.point + mean_q * T.t;
      return X.z() > 0 && (camera.project(X) - c.pixel).norm() < 2 * ICLK_MATCH_TOLERANCE * layout.scale;
    };
    poses.push_back(T);
    std::erase_if(all.moved, explained);
    std::erase_if(all.alike, explained);
  }
}

/// The number of features that look like their places by a pose, as a share of those that look like the answer's places.
/// Features with the same place by both poses are not counted.
double support(const std::vector<Sought>& sought, const PlaceDescriptors& places, const MatchLayout& layout,
               const Camera& camera, const Features& features, const SE3& T_10) {
  int answer = 0, pose = 0;
  for (const Sought& s : sought) {
    const PatchWarp warp = warp_patch(camera, features.uv[s.feature], features.inverse_depth[s.feature], T_10);
    if (!warp.valid) continue;
    const Vector2d at = to_map(warp.uv1, layout.scale);
    if ((at.array() < 3).any() || at.x() > layout.width - 4 || at.y() > layout.height - 4) continue;
    if ((at - s.own).lpNorm<Eigen::Infinity>() <= 1) continue;
    const float here = score_near(s, places, layout, s.own), there = score_near(s, places, layout, at);
    answer += here > kLeastScore;
    pose += there > std::max(kLeastScore, here - kAsMuch);
  }
  return static_cast<double>(pose) / std::max(answer, 1);
}

}  // namespace

Elsewhere look_elsewhere(const Map& reference, const Pair& pair, const Camera& camera, const Features& features,
                         std::span<const FeatureCheck> checks, const SE3& T_10, const std::vector<bool>& agree,
                         double explained, int most) {
  Elsewhere out;
  const MatchLayout layout = match_layout(camera);
  if (!layout.enabled || reference.data.empty()) return out;
  const Map map0 = match_map(reference, layout), map1 = match_map(visible_map(pair.target, pair.target_mask), layout);
  const PlaceDescriptors places = describe_places(map1, layout);
  const double mean_q = unit_of(features);
  const std::vector<Sought> sought = seek(map0, camera, features, checks, T_10, layout);
  Candidates candidates;
  int alike = 0;
  for (size_t first = 0; first < sought.size(); first += kSample) {
    if (first > 0 && explained >= kExplained && alike < kAlike * static_cast<double>(first)) return out;
    const auto count = static_cast<Eigen::Index>(std::min<size_t>(kSample, sought.size() - first));
    Eigen::Matrix<float, Eigen::Dynamic, kNumbers, Eigen::RowMajor> wanted(count, kNumbers);
    for (Eigen::Index k = 0; k < count; ++k) wanted.row(k) = sought[first + static_cast<size_t>(k)].descriptor;
    const Scores scores = wanted * places;
    for (Eigen::Index k = 0; k < count; ++k) {
      const Sought& s = sought[first + static_cast<size_t>(k)];
      const auto found = places_of(scores.row(k), layout, s.own);
      if (found.empty()) continue;
      const float here = score_near(s, places, layout, s.own);
      alike += found.front().first > here - kWorse;
      out.seen += !agree[s.feature] && found.front().first > kClear && found.front().first > here + kClearlyBetter;
      const Eigen::Vector3d point = camera.ray(features.uv[s.feature]) * (mean_q / features.inverse_depth[s.feature]);
      const auto pixel = [&](const Vector2d& at) -> Vector2d { return (at.array() + 0.5) * layout.scale - 0.5; };
      for (const auto& [score, at] : found) candidates.alike.push_back({point, pixel(at), score});
      const float next = found.size() > 1 ? found[1].first : kLeastScore;
      if (!agree[s.feature] && found.front().first > here + kBetter)
        candidates.moved.push_back({point, pixel(found.front().second), found.front().first - next});
    }
  }
  propose(candidates.moved, candidates, camera, mean_q, layout, most / 2, out.poses);
  propose(candidates.alike, candidates, camera, mean_q, layout, most - static_cast<int>(out.poses.size()), out.poses);
  std::erase_if(out.poses, [&](const SE3& T) { return support(sought, places, layout, camera, features, T) < kLeastSupport; });
  return out;
}

std::vector<bool> inliers(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                          const SE3& T_10, double inlier_distance) {
  std::vector<bool> agree(aligned.size());
  for (size_t i = 0; i < aligned.size(); ++i) {
    if (aligned[i].status != FeatureStatus::aligned) continue;
    const PatchWarp warp = warp_patch(camera, features.uv[i], features.inverse_depth[i], T_10);
    agree[i] = warp.valid && (warp.uv1 - aligned[i].uv1).norm() < inlier_distance;
  }
  return agree;
}

namespace {

/// The extent of points in px: the geometric mean of the standard deviations along both main directions.
double reach(const std::vector<Vector2d>& points) {
  if (points.size() < 3) return 0;
  const auto n = static_cast<double>(points.size());
  Vector2d mean = Vector2d::Zero();
  for (const Vector2d& p : points) mean += p / n;
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const Vector2d& p : points) scatter += (p - mean) * (p - mean).transpose() / n;
  return std::pow(scatter.determinant(), 0.25);
}

}  // namespace

Contest compare(const Camera& camera, const Features& features, const RefinedAlignment& first, const RefinedAlignment& second,
                double inlier_distance) {
  const auto a = inliers(camera, features, first.features, first.T_10, inlier_distance);
  const auto b = inliers(camera, features, second.features, second.T_10, inlier_distance);
  const auto better = [](const AlignedFeature& one, const AlignedFeature& other) {  // by more than noise
    return 2 * (1 - one.correlation) + 0.005 < 1 - other.correlation;
  };
  const auto shows = [](const AlignedFeature& f) {
    return f.status != FeatureStatus::out_of_image && f.status != FeatureStatus::hidden;
  };
  std::vector<Vector2d> firsts, seconds;
  for (size_t i = 0; i < a.size(); ++i) {
    const AlignedFeature &in_first = first.features[i], &in_second = second.features[i];
    if (a[i] && shows(in_second) && !(b[i] && !better(in_first, in_second))) firsts.push_back(features.uv[i]);
    if (b[i] && shows(in_first) && !(a[i] && !better(in_second, in_first))) seconds.push_back(features.uv[i]);
  }
  return {static_cast<int>(firsts.size()), static_cast<int>(seconds.size()), reach(firsts), reach(seconds)};
}

std::vector<bool> still(const Camera& camera, const Features& features, const RefinedAlignment& answer,
                        double inlier_distance) {
  std::vector<bool> out(features.uv.size());
  if (answer.refined) {
    out = inliers(camera, features, answer.features, answer.T_10, inlier_distance);
    for (size_t i = 0; i < out.size(); ++i) out[i] = out[i] && (answer.features[i].uv1 - features.uv[i]).norm() < ICLK_STILL;
    return out;
  }
  for (size_t i = 0; i < out.size(); ++i) {
    if (!(features.inverse_depth[i] > 0)) continue;
    const PatchWarp warp = warp_patch(camera, features.uv[i], features.inverse_depth[i], answer.T_10);
    out[i] = warp.valid && (warp.uv1 - features.uv[i]).norm() < inlier_distance;
  }
  return out;
}

std::vector<double> motions(const View& view, const SE3& a, const SE3& b) {
  std::vector<double> m;
  for (size_t i = 0; i < view.checks.size(); ++i) {
    if (view.checks[i] != FeatureCheck::ok) continue;
    const PatchWarp wa = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], a);
    const PatchWarp wb = warp_patch(view.camera, view.features.uv[i], view.features.inverse_depth[i], b);
    m.push_back(wa.valid && wb.valid ? (wb.uv1 - wa.uv1).norm() : std::numeric_limits<double>::infinity());
  }
  std::sort(m.begin(), m.end());
  return m;
}

double median_motion(const View& view, const SE3& a, const SE3& b) {
  const std::vector<double> all = motions(view, a, b);
  return all.empty() ? std::numeric_limits<double>::infinity() : all[all.size() / 2];
}

namespace {

/// Whether one pose dominates: the other explains only repetitions, or a small part that moves independently. Widely spread
/// features count more, because the scene surrounds the objects that move in it.
bool dominates(const View& view, const RefinerOptions& options, const RefinedAlignment& one, const RefinedAlignment& other) {
  const Contest c = compare(view.camera, view.features, one, other, options.pose.inlier_distance);
  return c.first >= std::max<double>(options.min_inliers, 0.1 * one.inliers) &&
         c.second * c.second_reach <= options.max_rival_share * c.first * c.first_reach;
}

/// Replaces the answer by the rival; the result of ICLK is kept.
void take(RefinedAlignment& rival, RefinedAlignment& answer) {
  rival.iclk = std::move(answer.iclk);
  rival.stages.insert(rival.stages.begin(), answer.stages.front());
  answer = std::move(rival);
}

}  // namespace

void weigh(const View& view, const RefinerOptions& options, std::span<RefinedAlignment> rivals, RefinedAlignment& answer) {
  RefinedAlignment* best = &answer;
  for (RefinedAlignment& rival : rivals)
    if (rival.converged() && dominates(view, options, rival, *best)) best = &rival;
  std::vector<Rival> others;
  const auto consider = [&](const RefinedAlignment& other) {
    if (&other == best || other.inliers < options.min_inliers) return;
    const double apart = median_motion(view, best->T_10, other.T_10);
    if (!(apart > options.pose.inlier_distance) || dominates(view, options, *best, other)) return;
    others.push_back({other.T_10, other.inliers});
  };
  consider(answer);
  for (const RefinedAlignment& rival : rivals) consider(rival);
  if (best != &answer) {
    take(*best, answer);
  }
  if (others.empty()) return;
  std::sort(others.begin(), others.end(), [](const Rival& a, const Rival& b) { return a.inliers > b.inliers; });
  answer.rivals = std::move(others);
  answer.status = Status::ambiguous;
  answer.covariance.setZero();
  answer.reason = rival_text(answer.rivals.front().inliers) + answer.reason;
}

void prefer_confirmed(std::span<RefinedAlignment> rivals, RefinedAlignment& answer) {
  RefinedAlignment* best = nullptr;
  for (RefinedAlignment& rival : rivals)
    if (rival.converged() && (!best || rival.inliers > best->inliers)) best = &rival;
  if (!best) return;
  take(*best, answer);
}

void doubt_stillness(const View& view, const RefinerOptions& options, int seen, RefinedAlignment& answer) {
  const auto count = static_cast<int>(view.checks.size());
  std::vector<bool> fixed = still(view.camera, view.features, answer, options.pose.inlier_distance);
  const auto standing = static_cast<int>(std::count(fixed.begin(), fixed.end(), true));
  const int inliers = answer.refined ? answer.inliers : count;
  if (standing < options.min_inliers || standing < 0.25 * inliers || seen < std::max(3.0, 0.02 * inliers)) return;
  answer.fixed = std::move(fixed);
  answer.status = Status::ambiguous;
  answer.covariance.setZero();
  answer.reason = stillness_text(standing, inliers, seen) + answer.reason;
}

std::string rival_text(int inliers) {
  return std::to_string(inliers) + " features agree on another pose, which explains the images just as well: ";
}

std::string stillness_text(int standing, int inliers, int seen) {
  return std::to_string(standing) + " features of " + std::to_string(inliers) +
         " do not move in the image and may be fixed to the camera, while " + std::to_string(seen) + " are seen elsewhere; ";
}

}  // namespace iclk::internal
