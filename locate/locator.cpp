#include <iclk/locate/locator.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <tuple>

#include <Eigen/Cholesky>

#include <iclk/align/pyramid.h>
#include <iclk/engine/error.h>
#include <iclk/locate/internal/hypotheses.h>
#include <iclk/locate/internal/map_fit.h>
#include <iclk/locate/internal/map_window.h>
#include <iclk/render/renderer.h>
#include <iclk/session/session.h>

namespace iclk {
namespace {

constexpr size_t kBatch = 16;         // views that are compared at a time
constexpr int kFewestFeatures = 20;   // of a view that is worth comparing
constexpr double kAnotherPlace = 16;  // px: poses that differ by more are two
constexpr int kSmallest = 160;        // px: width of the pictures that are aligned, at least
constexpr double kSlope = 0.25;       // heights this many steps apart move pixels on the ground by as much
constexpr double kRivalShare = 0.5;   // of the answer's inliers: as many make another place a rival

[[noreturn]] void refuse(const std::string& what) { throw Error(ErrorCode::invalid_argument, what); }

using internal::MapFit;
using internal::median_depth;
using internal::motion;
using internal::Picture;
using internal::SmallPicture;
using internal::view_of;

struct Candidate {
  SE3 T_WC;
  bool likely = false;  // the prior allows what was found; else T_WC is the hypothesis
  bool converged = false;
  int inliers = 0;
};

using Allowed = std::function<bool(const SE3&)>;

RenderOptions view_options() {
  RenderOptions options;
  options.samples = 1;  // the mosaic is filtered; more rays smooth only the edges of the relief
  options.max_anisotropy = 4;
  return options;
}

SessionOptions coarse_options(SessionOptions options, bool second_looks) {
  options.second_looks = second_looks;
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
  Session coarse, thorough;  // without and with second looks
  MapFit fine;

  Impl(const std::shared_ptr<engine::Context>& context, std::shared_ptr<const TerrainSource> source, const LocatorOptions& o)
      : options(o),
        map(context, std::move(source), view_options()),
        coarse(coarse_options(internal::fit_options(o.session), false), context),
        thorough(coarse_options(internal::fit_options(o.session), true), context),
        fine(context, map, o) {}

  void compare(Session& session, const Picture& picture, std::span<const SE3> poses, const Allowed& likely,
               std::vector<Candidate>& found);
  double distance(const Camera& camera, const LocatePrior& prior);
  int map_level(const Camera& camera, double distance) const;
  std::vector<Candidate> candidates(const Picture& picture, const LocatePrior& prior, double distance, int& hypotheses);
  bool another_place(const Camera& camera, const SE3& a, const SE3& b);
  Located locate(const Picture& full, const LocatePrior& prior);
};

/// Aligns the image with a view at each pose.
void Locator::Impl::compare(Session& session, const Picture& picture, std::span<const SE3> poses, const Allowed& likely,
                            std::vector<Candidate>& found) {
  std::vector<View> views(poses.size());
  std::vector<Map> greys(poses.size());
  std::vector<CascadePair> pairs;
  std::vector<SE3> starts;
  for (size_t i = 0; i < poses.size(); ++i) {
    if (!fine.above_ground(poses[i])) continue;
    views[i] = map.renderer().render(picture.camera, poses[i]);
    greys[i] = grey_map(views[i].image());
    CascadePair pair;
    pair.reference.image = view_of(greys[i]);
    pair.reference.camera = picture.camera;
    pair.reference.features = detect_features(pair.reference.image, views[i].depth_image(), {}, session.options().detector);
    pair.target = picture.image;
    pair.target_mask = picture.mask;
    if (pair.reference.features.size() < kFewestFeatures) continue;
    pairs.push_back(std::move(pair));
    starts.push_back(poses[i]);
  }
  if (pairs.empty()) return;
  const std::vector<RefinedAlignment> results = session.align(pairs);
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
  if (fine.above_ground(prior.T_WC))
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
  for (Session* session : {&coarse, &thorough}) {
    found.clear();
    for (size_t i = 0; i < poses.size(); i += kBatch)
      compare(*session, coarse_picture.picture, std::span(poses).subspan(i, std::min(kBatch, poses.size() - i)), likely, found);
    if (std::any_of(found.begin(), found.end(), [](const Candidate& c) { return c.converged; })) break;
  }
  std::stable_sort(found.begin(), found.end(), [](const Candidate& a, const Candidate& b) {
    return std::tuple(a.converged, a.inliers, a.likely) > std::tuple(b.converged, b.inliers, b.likely);
  });
  for (const Candidate& c : found) {
    if (static_cast<int>(best.size()) == options.candidates) break;
    const auto known = [&](const Candidate& b) { return motion(small, b.T_WC.inverse() * c.T_WC, distance) < kAnotherPlace; };
    if (fine.above_ground(c.T_WC) && std::none_of(best.begin(), best.end(), known)) best.push_back(c);
  }
  return best;
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
  if (!fine.above_ground({prior.T_WC.R, prior.T_WC.t + options.reach * prior.height_sigma * Eigen::Vector3d::UnitZ()})) {
    best.reason = "the prior is below the ground of the map";
    return best;
  }
  int hypotheses = 0;
  std::string doubt;
  const double away = distance(full.camera.at_level(2), prior);
  const SmallPicture as_the_map(full, map_level(full.camera, away));
  const Picture& picture = as_the_map.picture;
  const double finest = std::max(map.terrain().mosaic.step_x, away / std::abs(full.camera.fx));
  for (const Candidate& c : candidates(full, prior, away, hypotheses)) {
    // After a converged answer, only places that also converged can be rivals.
    if (best.converged() && !c.converged) break;
    auto [other, doubt_of_other] = fine.fit(picture, c.T_WC, finest);
    if (other.converged() && !internal::likely_attitude(other.T_WC, prior, options.reach + 1)) {
      other.status = Status::diverged;
      other.covariance.setZero();
      other.reason = "the prior excludes the attitude that fits; " + other.reason;
    }
    if (!best.converged()) {
      if (other.converged() || best.rounds == 0) best = other, doubt = doubt_of_other;
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
  } else if (best.converged() && !doubt.empty()) {
    best.status = Status::degenerate;
    best.covariance.setZero();
    best.reason = doubt + "; " + best.reason;
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
