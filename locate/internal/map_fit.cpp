#include <iclk/locate/internal/map_fit.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include <iclk/locate/internal/map_errors.h>
#include <Eigen/Cholesky>

namespace iclk::internal {
namespace {

// Of the width, by which a view looks past the pose: what is fixed to the camera stays, the ground does not.
constexpr double kAside = 0.0375;
constexpr double kInlier = 1.5;      // px; features that do not confirm a pose are off by as much
constexpr double kLeastSigma = 0.2;  // px: of a feature's position
constexpr double kSettled = 6;       // squared step, normalised by the covariance
constexpr double kMapSigma = 1;      // px: of features' positions, at the level of the map
constexpr double kClearShare = 0.2;  // RefinerOptions::min_clear_share
constexpr double kVague = 1.7;       // of `finest`: a claim's standard deviation on the ground, if light may differ

/// The last step is one that errors of two views explain.
bool settled(const Located& located, const SE3& before) {
  const Vector6d step = (located.T_WC.inverse() * before).log();
  const Eigen::LLT<Matrix6d> factor(located.covariance);
  return factor.info() == Eigen::Success && step.dot(factor.solve(step)) < kSettled;
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

bool refuse(Located& located, Status status, std::string reason) {
  located.status = status;
  located.reason = std::move(reason);
  located.covariance.setZero();
  return false;
}

std::string doubt(double sigma, double allowed) {
  std::ostringstream why;
  why.precision(2);
  why << "picture and map may be lit differently, and rough ground looks shifted then: the pose is uncertain by " << sigma
      << " m on the ground, " << allowed << " m allowed";
  return why.str();
}

}  // namespace

SessionOptions fit_options(SessionOptions options) {
  options.refiner.pose.max_sigma = std::max(options.refiner.pose.max_sigma, kMapSigma);
  options.refiner.min_clear_share = std::min(options.refiner.min_clear_share, kClearShare);
  return options;
}

MapFit::MapFit(std::shared_ptr<engine::Context> context, MapWindow& map, const LocatorOptions& options)
    : map_(map), options_(options), session_(fit_options(options.session), std::move(context)) {}

bool MapFit::above_ground(const SE3& T_WC) const {
  const auto ground = map_.terrain().height_at(T_WC.t.x(), T_WC.t.y());
  return !ground || *ground < T_WC.t.z();
}

bool MapFit::look(const Picture& picture, Located& located, Round& round) {
  if (!above_ground(located.T_WC)) return refuse(located, Status::diverged, "the pose is below the ground");
  Vector6d turn = Vector6d::Zero();
  turn[4] = kAside * picture.camera.width / picture.camera.fx;
  round.T_WV = located.T_WC * SE3::exp(turn);
  const View view = map_.renderer().render(picture.camera, round.T_WV);
  const auto distance = median_depth(view);
  if (!distance) return refuse(located, Status::low_overlap, "the map has no ground under the picture");
  round.distance = *distance;
  CascadePair pair;
  pair.reference.image = view.image(), pair.reference.camera = picture.camera;
  pair.reference.features = detect_features(view.image(), view.depth_image(), {}, options_.session.detector);
  pair.target = picture.image, pair.target_mask = picture.mask;
  round.answer = session_.align(pair);
  round.points = seen_points(picture.camera, pair.reference.features, round.answer);
  return true;
}

std::vector<double> MapFit::roughness(const Round& round, const SE3& T_WC) const {
  std::vector<double> all;
  for (const Eigen::Vector3d& X : round.points) {
    const Eigen::Vector3d ground = T_WC * X;
    all.push_back(ground_roughness(map_.terrain(), ground.x(), ground.y()));
  }
  return all;
}

bool MapFit::judge(const Picture& picture, const Round& round, double finest, Fit& fit) const {
  Located& located = fit.located;
  const RefinedAlignment& answer = round.answer;
  const Terrain& seen = map_.terrain();
  const bool same_light =
      answer.refined && !answer.by_lines && answer.inliers >= options_.session.refiner.min_inlier_share * answer.visible;
  const std::vector<double> rough = same_light ? std::vector<double>{} : roughness(round, located.T_WC);
  const double sigma = std::max(answer.sigma, answer.refined ? kLeastSigma : kInlier);
  const Matrix6d of_map =
      map_covariance(picture.camera, round.points, located.T_WC.R, {sigma, seen.mosaic.step_x, seen.relief.step_x, rough});
  if (of_map.isZero()) return refuse(located, Status::degenerate, "the features leave the pose open to errors of the map");
  const double vague = same_light ? 0 : ground_sigma(picture.camera, round.points, of_map);
  fit.doubt = vague > kVague * finest ? doubt(vague, kVague * finest) : "";
  // T_WV (T_10 Exp(xi))^-1 = T_WC Exp(-A xi), A = Ad(T_10)
  const Matrix6d A = adjoint(answer.T_10);
  located.covariance = A * answer.covariance * A.transpose() + of_map;
  return true;
}

MapFit::Fit MapFit::fit(const Picture& picture, const SE3& start, double finest) {
  Fit fit;
  Located& located = fit.located;
  located.T_WC = start;
  while (located.rounds < options_.rounds) {
    Round round;
    if (!look(picture, located, round)) return fit;
    const RefinedAlignment& answer = round.answer;
    const SE3 before = located.T_WC;
    located.rounds += 1;
    located.status = answer.status, located.reason = answer.reason, located.model = answer.model;
    located.inliers = answer.inliers, located.visible = answer.visible, located.sigma = answer.sigma;
    located.T_WC = round.T_WV * answer.T_10.inverse();
    located.T_WC.orthonormalize();
    located.rivals.clear();
    located.covariance.setZero();
    for (const Rival& rival : answer.rivals) located.rivals.push_back(round.T_WV * rival.T_10.inverse());
    if (!answer.converged() || !judge(picture, round, finest, fit)) return fit;
    if (motion(picture.camera, located.T_WC.inverse() * before, round.distance) < options_.tolerance) return fit;
    if (located.rounds > 1 && settled(located, before)) return fit;
  }
  refuse(located, Status::max_iterations, "the pose still moved after " + std::to_string(options_.rounds) + " views");
  return fit;
}

}  // namespace iclk::internal
