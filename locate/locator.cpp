#include <iclk/locate/locator.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <tuple>

#include <Eigen/Cholesky>

#include <iclk/align/pyramid.h>
#include <iclk/engine/error.h>
#include <iclk/locate/internal/hypotheses.h>
#include <iclk/locate/internal/map_errors.h>
#include <iclk/locate/internal/map_window.h>
#include <iclk/render/renderer.h>
#include <iclk/session/session.h>

namespace iclk {
namespace {

constexpr size_t kBatch = 16;         // views that are compared at a time
constexpr int kFewestFeatures = 20;   // of a view that is worth comparing
constexpr double kAnotherPlace = 16;  // px: poses that differ by more are two
// Of the width, by which a view looks past the pose: what is fixed to the camera stays, the ground does not.
constexpr double kAside = 0.0375;
constexpr int kSmallest = 160;       // px: width of the pictures that are aligned, at least
constexpr double kInlier = 1.5;      // px; features that do not confirm a pose are off by as much
constexpr double kLeastSigma = 0.2;  // px: of a feature's position
constexpr double kSettled = 6;       // squared step, normalised by the covariance
constexpr double kSlope = 0.25;      // heights this many steps apart move pixels on the ground by as much
constexpr double kMapSigma = 1;      // px: of features' positions, at the level of the map
constexpr double kRivalShare = 0.5;  // of the answer's inliers: as many make another place a rival

[[noreturn]] void refuse(const std::string& what) { throw Error(ErrorCode::invalid_argument, what); }

struct Picture {
  ImageView image, mask;
  Camera camera;
};

/// A picture of 2^level x 2^level means, and its pixels.
struct SmallPicture {
  Pyramid grey;
  std::vector<uint8_t> hidden;
  Picture picture;

  SmallPicture(const Picture& full, int level);
};

struct Candidate {
  SE3 T_WC;
  bool likely = false;  // the prior allows what was found; else T_WC is the hypothesis
  bool converged = false;
  int inliers = 0;
};

using Allowed = std::function<bool(const SE3&)>;

ImageView view_of(const Map& map) { return {map.data.data(), map.width, map.height, 0, PixelFormat::r32f}; }

/// The mask of an image of 2^level x 2^level means: 0 where a mean has a hidden pixel.
std::vector<uint8_t> small_mask(const ImageView& mask, int level) {
  const int width = mask.width >> level, height = mask.height >> level;
  std::vector<uint8_t> small(static_cast<size_t>(width) * static_cast<size_t>(height), 255);
  for (int v = 0; v < height << level; ++v) {
    uint8_t* row = small.data() + static_cast<size_t>(v >> level) * static_cast<size_t>(width);
    for (int u = 0; u < width << level; ++u)
      if (mask.row(v)[u] == 0) row[u >> level] = 0;
  }
  return small;
}

SmallPicture::SmallPicture(const Picture& full, int level) : picture(full) {
  if (level == 0) return;
  grey = grey_pyramid(full.image, level + 1);
  picture = {view_of(grey.back()), {}, full.camera.at_level(level)};
  if (full.mask.empty()) return;
  hidden = small_mask(full.mask, level);
  picture.mask = {hidden.data(), picture.camera.width, picture.camera.height, 0, PixelFormat::r8};
}

/// The last step is one that errors of two views explain.
bool settled(const Located& located, const SE3& before) {
  const Vector6d step = (located.T_WC.inverse() * before).log();
  const Eigen::LLT<Matrix6d> factor(located.covariance);
  return factor.info() == Eigen::Success && step.dot(factor.solve(step)) < kSettled;
}

/// m; nothing if the view shows no ground.
std::optional<double> median_depth(const View& view) {
  std::vector<float> depth;
  std::copy_if(view.depth.begin(), view.depth.end(), std::back_inserter(depth), [](float z) { return z > 0; });
  if (depth.empty()) return std::nullopt;
  const auto middle = depth.begin() + static_cast<ptrdiff_t>(depth.size() / 2);
  std::nth_element(depth.begin(), middle, depth.end());
  return *middle;
}

/// px: how far T moves the corners of an image whose pixels are at this distance, the most of the four.
double motion(const Camera& camera, const SE3& T, double distance) {
  double most = 0;
  for (const double u : {0.0, camera.width - 1.0})
    for (const double v : {0.0, camera.height - 1.0}) {
      const Eigen::Vector3d X = T * Eigen::Vector3d(distance * camera.ray({u, v}));
      if (X.z() <= 0) return INFINITY;
      most = std::max(most, (camera.project(X) - Eigen::Vector2d(u, v)).norm());
    }
  return most;
}

/// Points of the ground that the answer rests on, in the camera's frame.
std::vector<Eigen::Vector3d> seen_points(const Camera& camera, const Features& features, const RefinedAlignment& answer) {
  std::vector<Eigen::Vector3d> points;
  for (size_t i = 0; i < features.uv.size(); ++i) {
    if (!(features.inverse_depth[i] > 0)) continue;
    const Eigen::Vector3d X = answer.T_10 * Eigen::Vector3d(camera.ray(features.uv[i]) / features.inverse_depth[i]);
    if (X.z() <= 0) continue;
    const Eigen::Vector2d uv = camera.project(X);
    const bool aligned = i < answer.features.size() && answer.features[i].status == FeatureStatus::aligned;
    if (answer.refined ? aligned && (answer.features[i].uv1 - uv).norm() < kInlier : camera.contains(uv)) points.push_back(X);
  }
  return points;
}

RenderOptions view_options() {
  RenderOptions options;
  options.samples = 1;  // the mosaic is filtered; more rays smooth only the edges of the relief
  options.max_anisotropy = 4;
  return options;
}

/// Positions and heights of a map are off by a share of its pixels, which images of one camera are not.
SessionOptions fine_options(SessionOptions options) {
  options.refiner.pose.max_sigma = std::max(options.refiner.pose.max_sigma, kMapSigma);
  return options;
}

SessionOptions coarse_options(SessionOptions options) {
  options.model = "classical";
  options.stages.clear();
  options.search = SearchMode::on;
  options.detector.count = 100;
  options.batch = static_cast<int>(kBatch);
  return options;
}

/// A map that is in memory: each window is all of it.
class WholeTerrain : public TerrainSource {
 public:
  explicit WholeTerrain(std::shared_ptr<const Terrain> terrain) : terrain_(std::move(terrain)) { terrain_->check(); }
  MapBox extent() const override { return terrain_->extent(); }
  std::shared_ptr<const Terrain> window(const MapBox&, double) const override { return terrain_; }

 private:
  std::shared_ptr<const Terrain> terrain_;
};

}  // namespace

void LocatePrior::check() const {
  if (!T_WC.R.allFinite() || !T_WC.t.allFinite()) refuse("the pose of the prior is not finite");
  for (const double sigma : {position_sigma, height_sigma, tilt_sigma, heading_sigma})
    if (!(sigma >= 0 && std::isfinite(sigma))) refuse("a sigma of the prior is " + std::to_string(sigma) + "; give 0 or more");
}

void LocatorOptions::check() const {
  if (!(reach > 0 && reach <= 10)) refuse("reach " + std::to_string(reach) + " must be above 0 and at most 10");
  if (coarse_width < 64) refuse("coarse_width " + std::to_string(coarse_width) + " must be at least 64");
  if (candidates < 1 || rounds < 1) refuse("candidates and rounds must be at least 1");
  if (!(tolerance > 0)) refuse("tolerance " + std::to_string(tolerance) + " must be positive");
}

struct Locator::Impl {
  LocatorOptions options;
  internal::MapWindow map;
  Session coarse, fine;

  Impl(const std::shared_ptr<engine::Context>& context, std::shared_ptr<const TerrainSource> source, const LocatorOptions& o)
      : options(o),
        map(context, std::move(source), view_options()),
        coarse(coarse_options(fine_options(o.session)), context),
        fine(fine_options(o.session), context) {}

  bool above_ground(const SE3& T_WC) const {
    const auto ground = map.terrain().height_at(T_WC.t.x(), T_WC.t.y());
    return !ground || *ground < T_WC.t.z();
  }

  void compare(const Picture& picture, std::span<const SE3> poses, const Allowed& likely, std::vector<Candidate>& found);
  double distance(const Camera& camera, const LocatePrior& prior);
  int map_level(const Camera& camera, double distance) const;
  std::vector<Candidate> candidates(const Picture& picture, const LocatePrior& prior, double distance, int& hypotheses);
  Located refine(const Picture& picture, const SE3& start);
  Matrix6d map_covariance(const Camera& camera, const Features& features, const RefinedAlignment& answer,
                          const SE3& T_WC) const;
  bool another_place(const Camera& camera, const SE3& a, const SE3& b);
  Located locate(const Picture& full, const LocatePrior& prior);
};

/// Aligns the image with a view at each pose.
void Locator::Impl::compare(const Picture& picture, std::span<const SE3> poses, const Allowed& likely,
                            std::vector<Candidate>& found) {
  std::vector<View> views(poses.size());
  std::vector<Map> greys(poses.size());
  std::vector<CascadePair> pairs;
  std::vector<SE3> starts;
  for (size_t i = 0; i < poses.size(); ++i) {
    if (!above_ground(poses[i])) continue;
    views[i] = map.renderer().render(picture.camera, poses[i]);
    greys[i] = grey_map(views[i].image());
    CascadePair pair;
    pair.reference.image = view_of(greys[i]);
    pair.reference.camera = picture.camera;
    pair.reference.features = detect_features(pair.reference.image, views[i].depth_image(), {}, coarse.options().detector);
    pair.target = picture.image;
    pair.target_mask = picture.mask;
    if (pair.reference.features.size() < kFewestFeatures) continue;
    pairs.push_back(std::move(pair));
    starts.push_back(poses[i]);
  }
  if (pairs.empty()) return;
  const std::vector<RefinedAlignment> results = coarse.align(pairs);
  for (size_t i = 0; i < results.size(); ++i) {
    const SE3 T_WC = starts[i] * results[i].T_10.inverse();
    if (likely(T_WC))
      found.push_back({T_WC, true, results[i].converged(), results[i].inliers});
    else
      found.push_back({starts[i]});
  }
}

/// m from the camera of the prior to the ground.
double Locator::Impl::distance(const Camera& camera, const LocatePrior& prior) {
  if (above_ground(prior.T_WC))
    if (const auto seen = median_depth(map.renderer().render(camera, prior.T_WC))) return *seen;
  const auto ground = map.terrain().height_at(prior.T_WC.t.x(), prior.T_WC.t.y());
  return std::max({1.0, prior.T_WC.t.z() - ground.value_or(0), options.reach * prior.height_sigma});
}

/// The level at which the picture is as coarse as the map: finer pixels see what the map does not have.
int Locator::Impl::map_level(const Camera& camera, double distance) const {
  const Terrain& seen = map.terrain();
  const double texel = std::abs(camera.fx) * std::max(seen.mosaic.step_x, kSlope * seen.relief.step_x) / distance;
  const double least = std::log2(1.0 * camera.width / kSmallest);
  return std::max(0, static_cast<int>(std::lround(std::min(std::log2(texel), std::floor(least)))));
}

/// The best hypotheses, each at another place.
std::vector<Candidate> Locator::Impl::candidates(const Picture& picture, const LocatePrior& prior, double distance,
                                                 int& hypotheses) {
  const int level = std::max(0, static_cast<int>(std::lround(std::log2(1.0 * picture.camera.width / options.coarse_width))));
  const SmallPicture coarse_picture(picture, level);
  const Camera& small = coarse_picture.picture.camera;
  const std::vector<SE3> poses = internal::hypotheses(prior, picture.camera, distance, options.reach);
  hypotheses = static_cast<int>(poses.size());
  std::vector<Candidate> found, best;
  const Allowed likely = [&](const SE3& T_WC) { return internal::likely(T_WC, prior, distance, options.reach + 1); };
  for (size_t i = 0; i < poses.size(); i += kBatch)
    compare(coarse_picture.picture, std::span(poses).subspan(i, std::min(kBatch, poses.size() - i)), likely, found);
  std::stable_sort(found.begin(), found.end(), [](const Candidate& a, const Candidate& b) {
    return std::tuple(a.converged, a.inliers, a.likely) > std::tuple(b.converged, b.inliers, b.likely);
  });
  for (const Candidate& c : found) {
    if (static_cast<int>(best.size()) == options.candidates) break;
    const auto known = [&](const Candidate& b) { return motion(small, b.T_WC.inverse() * c.T_WC, distance) < kAnotherPlace; };
    if (above_ground(c.T_WC) && std::none_of(best.begin(), best.end(), known)) best.push_back(c);
  }
  return best;
}

Matrix6d Locator::Impl::map_covariance(const Camera& camera, const Features& features, const RefinedAlignment& answer,
                                       const SE3& T_WC) const {
  const Terrain& seen = map.terrain();
  const double sigma = std::max(answer.sigma, answer.refined ? kLeastSigma : kInlier);
  return internal::map_covariance(camera, seen_points(camera, features, answer), T_WC.R,
                                  {sigma, seen.mosaic.step_x, seen.relief.step_x});
}

Located Locator::Impl::refine(const Picture& picture, const SE3& start) {
  const Camera& camera = picture.camera;
  Vector6d turn = Vector6d::Zero();
  turn[4] = kAside * camera.width / camera.fx;
  const SE3 aside = SE3::exp(turn);
  Located located;
  located.T_WC = start;
  while (located.rounds < options.rounds) {
    if (!above_ground(located.T_WC)) {
      located.status = Status::diverged, located.reason = "the pose is below the ground";
      return located;
    }
    const SE3 T_WV = located.T_WC * aside;
    const View view = map.renderer().render(camera, T_WV);
    const auto distance = median_depth(view);
    if (!distance) {
      located.status = Status::low_overlap, located.reason = "the map has no ground under the picture";
      return located;
    }
    CascadePair pair;
    pair.reference.image = view.image(), pair.reference.camera = camera;
    pair.reference.features = detect_features(view.image(), view.depth_image(), {}, options.session.detector);
    pair.target = picture.image, pair.target_mask = picture.mask;
    const RefinedAlignment answer = fine.align(pair);
    const SE3 before = located.T_WC;
    located.rounds += 1;
    located.status = answer.status, located.reason = answer.reason, located.model = answer.model;
    located.inliers = answer.inliers, located.visible = answer.visible, located.sigma = answer.sigma;
    located.T_WC = T_WV * answer.T_10.inverse();
    located.T_WC.orthonormalize();
    located.rivals.clear();
    located.covariance.setZero();
    for (const Rival& rival : answer.rivals) located.rivals.push_back(T_WV * rival.T_10.inverse());
    if (!answer.converged()) return located;
    // T_WV (T_10 Exp(xi))^-1 = T_WC Exp(-A xi), A = Ad(T_10)
    const Matrix6d A = adjoint(answer.T_10);
    const Matrix6d of_map = map_covariance(camera, pair.reference.features, answer, located.T_WC);
    if (of_map.isZero()) {
      located.status = Status::degenerate, located.reason = "the features leave the pose open to errors of the map";
      return located;
    }
    located.covariance = A * answer.covariance * A.transpose() + of_map;
    if (motion(camera, located.T_WC.inverse() * before, *distance) < options.tolerance) return located;
    if (located.rounds > 1 && settled(located, before)) return located;
  }
  located.status = Status::max_iterations;
  located.covariance.setZero();
  located.reason = "the pose still moved after " + std::to_string(options.rounds) + " views";
  return located;
}

bool Locator::Impl::another_place(const Camera& camera, const SE3& a, const SE3& b) {
  const auto distance = median_depth(map.renderer().render(camera, a));
  return !distance || motion(camera, a.inverse() * b, *distance) > kAnotherPlace;
}

Located Locator::Impl::locate(const Picture& full, const LocatePrior& prior) {
  Located best;
  best.T_WC = prior.T_WC;
  best.status = Status::low_overlap;
  best.reason = "the map shows too little where the prior looks";
  if (!map.cover(full.camera, prior, options.reach)) return best;
  if (!above_ground({prior.T_WC.R, prior.T_WC.t + options.reach * prior.height_sigma * Eigen::Vector3d::UnitZ()})) {
    best.reason = "the prior is below the ground of the map";
    return best;
  }
  int hypotheses = 0;
  const double away = distance(full.camera.at_level(2), prior);
  const SmallPicture as_the_map(full, map_level(full.camera, away));
  const Picture& picture = as_the_map.picture;
  for (const Candidate& c : candidates(full, prior, away, hypotheses)) {
    // After a converged answer, only places that also converged can be rivals.
    if (best.converged() && !c.converged) break;
    const Located other = refine(picture, c.T_WC);
    if (!best.converged()) {
      if (other.converged() || best.rounds == 0) best = other;
    } else if (other.converged() && other.inliers >= kRivalShare * best.inliers &&
               another_place(picture.camera, best.T_WC, other.T_WC)) {
      best.rivals.push_back(other.T_WC);
    }
  }
  best.hypotheses = hypotheses;
  if (best.converged() && !best.rivals.empty()) {
    best.status = Status::ambiguous;
    best.covariance.setZero();
    best.reason = "the picture fits at " + std::to_string(best.rivals.size() + 1) + " places of the map";
  }
  return best;
}

Locator::Locator(std::shared_ptr<engine::Context> context, std::shared_ptr<const Terrain> map, const LocatorOptions& options)
    : Locator(std::move(context), std::make_shared<const WholeTerrain>(std::move(map)), options) {}
Locator::Locator(std::shared_ptr<engine::Context> context, std::shared_ptr<const TerrainSource> map,
                 const LocatorOptions& options) {
  options.check();
  impl_ = std::make_unique<Impl>(context, std::move(map), options);
}
Locator::~Locator() = default;

View Locator::view(const Camera& camera, const SE3& T_WC) {
  if (!impl_->map.cover(camera, {T_WC, 0, 0, 0, 0}, 1)) refuse("the map has nothing below this pose");
  return impl_->map.renderer().render(camera, T_WC);
}

const LocatorOptions& Locator::options() const { return impl_->options; }
const std::shared_ptr<engine::Context>& Locator::context() const { return impl_->fine.context(); }

Located Locator::locate(const ImageView& image, const Camera& camera, const LocatePrior& prior, const ImageView& mask) {
  prior.check();
  camera.check();
  if (image.width != camera.width || image.height != camera.height)
    refuse("the picture has " + std::to_string(image.width) + "x" + std::to_string(image.height) + " pixels, its camera " +
           std::to_string(camera.width) + "x" + std::to_string(camera.height));
  if (!mask.empty() && (mask.width != image.width || mask.height != image.height || mask.format != PixelFormat::r8))
    refuse("the mask must have one byte per pixel of the picture");
  return impl_->locate({image, mask, camera}, prior);
}

}  // namespace iclk
