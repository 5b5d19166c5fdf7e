// refine_pose.comp and refine_verdict.comp against refine_pose(), which Ceres solves in double precision.
#include <cmath>
#include <cstring>

#include <gtest/gtest.h>

#include <iclk/engine/submission.h>
#include <iclk/refine/internal/device_features.h>
#include <iclk/refine/internal/device_pose.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/refine/internal/uncertainty.h>

#include "bent_pair.h"
#include "correspondences.h"
#include "device.h"

namespace iclk {
namespace {

using test::deep_scene;
using test::difference;
using test::Scene;

/// A pair as feature alignment would leave it, started at `T_10`.
struct Case {
  Camera camera;
  Features features;
  std::vector<AlignedFeature> aligned;
  SE3 T_10;
  Matrix6d iclk_covariance = Matrix6d::Identity();
  bool search = true;
};

struct Outcome {
  shaders::RefinedInfo info;
  shaders::RefineState state;
  shaders::FeatureTask task;  ///< of the next round
  SE3 T_10;
  Matrix6d covariance;
};

std::vector<Outcome> run(const std::vector<Case>& cases, const RefinerOptions& options = {}) {
  using engine::BufferUse;
  using engine::MemoryKind;
  const auto context = test::device();
  const size_t n = cases.size();
  int most = 1;
  for (const Case& c : cases) most = std::max(most, c.features.size());
  const auto stride = static_cast<size_t>(most);
  const internal::PoseBuffers ids(static_cast<int>(n), most, context->unified_memory());
  const engine::Workspace memory(context, ids.plan);
  engine::MemoryPlan more;
  const auto references = more.add("references", sizeof(shaders::ReferenceInfo) * n, MemoryKind::upload, BufferUse::storage);
  const auto iclk = more.add("results", sizeof(shaders::ResultInfo) * n, MemoryKind::upload, BufferUse::storage);
  const auto found = more.add("aligned", sizeof(shaders::AlignedInfo) * n * stride, MemoryKind::upload, BufferUse::transfer);
  const auto refined = more.add("refined", sizeof(shaders::RefinedInfo) * n, MemoryKind::readback, BufferUse::transfer);
  const auto states = more.add("states", sizeof(shaders::RefineState) * n, MemoryKind::readback, BufferUse::transfer);
  const auto tasks = more.add("tasks", sizeof(shaders::FeatureTask) * n, MemoryKind::readback, BufferUse::transfer);
  const engine::Workspace host(context, more);
  for (size_t i = 0; i < n; ++i) {
    const Case& c = cases[i];
    const auto first = static_cast<uint32_t>(i * stride), count = static_cast<uint32_t>(c.features.size());
    const auto checks = check_features(c.features, c.camera);
    for (size_t k = 0; k < count; ++k) {
      memory[ids.features].as<shaders::FeatureInfo>()[first + k] =
          internal::pack_feature(c.features, k, checks[k] == FeatureCheck::ok);
      const AlignedFeature& a = c.aligned[k];
      host[found].as<shaders::AlignedInfo>()[first + k] = {static_cast<float>(a.uv1.x()),
                                                           static_cast<float>(a.uv1.y()),
                                                           static_cast<float>(a.covariance(0, 0)),
                                                           static_cast<float>(a.covariance(0, 1)),
                                                           static_cast<float>(a.covariance(1, 1)),
                                                           1,
                                                           0,
                                                           1,
                                                           1,
                                                           static_cast<uint32_t>(a.status)};
    }
    const auto index = static_cast<uint32_t>(i);
    const auto unit = static_cast<float>(internal::unit_of(c.features));
    memory[ids.pairs].as<shaders::RefinePair>()[i] = {index, index, first, count, unit, c.search, 0};
    host[references].as<shaders::ReferenceInfo>()[i] = {static_cast<float>(c.camera.fx),
                                                        static_cast<float>(c.camera.fy),
                                                        static_cast<float>(c.camera.cx),
                                                        static_cast<float>(c.camera.cy),
                                                        static_cast<float>(internal::unit_of(c.features)),
                                                        0,
                                                        count};
    shaders::ResultInfo result{};
    test::pack_pose(c.T_10, result.pose);
    for (int k = 0; k < 36; ++k) result.covariance[k] = static_cast<float>(c.iclk_covariance(k / 6, k % 6));
    host[iclk].as<shaders::ResultInfo>()[i] = result;
  }
  const internal::DevicePose pose(context, options, cases[0].camera.width, cases[0].camera.height);
  engine::ArenaSize size;
  pose.add_to(size);
  engine::DescriptorArena arena(context, size);
  engine::Submission submission(context);
  engine::Recorder recorder(submission, arena);
  recorder.upload(memory[ids.pairs], 0, memory[ids.pairs].size);
  recorder.upload(memory[ids.features], 0, memory[ids.features].size);
  recorder.copy(host[found], memory[ids.aligned], sizeof(shaders::AlignedInfo) * n * stride);
  const auto count = static_cast<uint32_t>(n);
  pose.start(recorder, ids, memory, host[iclk], count);
  pose.round(recorder, ids, memory, host[references], count);
  recorder.copy(memory[ids.tasks], host[tasks], sizeof(shaders::FeatureTask) * n);
  pose.unbend(recorder, ids, memory, host[references], count);
  pose.verdict(recorder, ids, memory, host[references], count);
  recorder.copy(memory[ids.refined], host[refined], sizeof(shaders::RefinedInfo) * n);
  recorder.copy(memory[ids.states], host[states], sizeof(shaders::RefineState) * n);
  recorder.host_read({&host[refined], &host[states], &host[tasks]});
  recorder.finish();
  submission.end();
  submission.submit_and_wait();
  std::vector<Outcome> outcomes;
  for (size_t i = 0; i < n; ++i) {
    Outcome o{host[refined].as<shaders::RefinedInfo>()[i],
              host[states].as<shaders::RefineState>()[i],
              host[tasks].as<shaders::FeatureTask>()[i],
              {},
              Matrix6d::Zero()};
    o.T_10 = test::unpack_pose(o.info.pose);
    for (int k = 0; k < 36; ++k) o.covariance(k / 6, k % 6) = o.info.covariance[k];
    outcomes.push_back(o);
  }
  return outcomes;
}

Case case_of(const Scene& scene, int count, double sigma, double outliers, uint32_t seed, double depth_error = 0) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  Case c{scene.camera, test::random_features(scene, count, seed), {}, {}};
  c.aligned = test::correspondences(scene, c.features, sigma, random, outliers);
  for (AlignedFeature& a : c.aligned) a.covariance << 0.01, 0.002, 0.002, 0.004;
  for (double& q : c.features.inverse_depth) q *= 1 + depth_error * normal(random);
  Vector6d start;
  start << 0.3, -0.3, 0.2, 0.004, -0.004, 0.01;
  c.T_10 = scene.T_10 * SE3::exp(start);
  return c;
}

double motion(const Case& c, const SE3& a, const SE3& b) {
  double most = 0;
  for (size_t i = 0; i < c.features.uv.size(); ++i) {
    if (!c.features.uv[i].allFinite()) continue;
    const Eigen::Vector3d X = c.camera.ray(c.features.uv[i]) / c.features.inverse_depth[i];
    most = std::max(most, (c.camera.project(a * X) - c.camera.project(b * X)).norm());
  }
  return most;
}

TEST(DevicePose, AgreesWithCeres) {
  ICLK_NEED_DEVICE();
  std::vector<Case> cases;
  for (const Scene& scene : {test::wide_scene(), deep_scene()})
    for (const auto& [count, sigma, outliers, depth] :
         {std::tuple{50, 0.05, 0.0, 0.0}, {200, 0.2, 0.3, 0.0}, {200, 0.02, 0.1, 0.01}, {12, 0.1, 0.0, 0.0}})
      cases.push_back(case_of(scene, count, sigma, outliers, static_cast<uint32_t>(7 + cases.size()), depth));
  for (size_t i = 0; i < cases.size(); i += 3) {  // some know their depths' sigma
    cases[i].features.inverse_depth_sigma.assign(cases[i].features.inverse_depth.size(), 0);
    for (size_t k = 0; k < cases[i].features.inverse_depth.size(); k += 2)
      cases[i].features.inverse_depth_sigma[k] = 0.02 * cases[i].features.inverse_depth[k];
  }
  for (Scene scene : {test::wide_scene(), deep_scene()}) {  // whose rows are reversed
    scene.camera.fy = -scene.camera.fy;
    cases.push_back(case_of(scene, 100, 0.05, 0.1, static_cast<uint32_t>(7 + cases.size())));
  }
  RefinerOptions options;
  options.rolling_shutter = false;
  const auto outcomes = run(cases, options);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const Case& c = cases[i];
    const PoseResult expected = refine_pose(c.camera, c.features, c.aligned, c.T_10);
    ASSERT_TRUE(expected.converged()) << expected.reason;
    const Outcome& o = outcomes[i];
    EXPECT_EQ(o.info.status, static_cast<uint32_t>(Status::converged));
    EXPECT_EQ(o.info.refined, 1u);
    EXPECT_LT(motion(c, o.T_10, expected.T_10), 2e-3);
    EXPECT_NEAR(o.state.floor, expected.floor, 0.01 * expected.floor);
    EXPECT_NEAR(o.state.depth_sigma, expected.depth_sigma, 0.01 * expected.depth_sigma + 1e-6);
    EXPECT_NEAR(o.info.sigma, expected.sigma, 0.01 * expected.sigma);
    EXPECT_EQ(o.info.used, static_cast<uint32_t>(expected.used));
    EXPECT_NEAR(o.info.inliers, expected.inliers, 1);
    EXPECT_LT(difference(expected.covariance, o.covariance), 0.03);
    EXPECT_NEAR(o.info.correction, motion(c, c.T_10, expected.T_10), motion(c, c.T_10, expected.T_10));
    EXPECT_EQ(o.task.feature_count, static_cast<uint32_t>(c.features.size()));  // it moved, so there is another round
    EXPECT_LT(motion(c, o.T_10, test::unpack_pose(o.task.pose)), 1e-3);
  }
}

TEST(DevicePose, AGivenCameraIsBelieved) {
  ICLK_NEED_DEVICE();
  const Case c = case_of(deep_scene(), 80, 0.05, 0.1, 3);
  RefinerOptions options;
  options.rolling_shutter = false;
  for (const double sigma : {0.0, 0.4}) {
    options.pose.camera_sigma = sigma;
    const Matrix6d expected = refine_pose(c.camera, c.features, c.aligned, c.T_10, options.pose).covariance;
    EXPECT_LT(difference(expected, run({c}, options)[0].covariance), 0.03);
    EXPECT_GT(difference(expected, run({c})[0].covariance), 0.1);
  }
}

TEST(DevicePose, UnitsOfLengthDropOut) {
  ICLK_NEED_DEVICE();
  std::vector<Case> cases{case_of(test::wide_scene(), 80, 0.05, 0.1, 3, 0.01)};
  for (const double unit : {1e-3, 1e4}) {
    Case c = cases[0];
    for (double& q : c.features.inverse_depth) q /= unit;
    c.T_10.t *= unit;
    cases.push_back(c);
  }
  const auto outcomes = run(cases);
  for (size_t i = 1; i < cases.size(); ++i) {
    const double unit = i == 1 ? 1e-3 : 1e4;
    EXPECT_EQ(outcomes[i].info.status, static_cast<uint32_t>(Status::converged));
    EXPECT_LT((outcomes[i].T_10.t / unit - outcomes[0].T_10.t).norm(), 1e-3);
    Matrix6d covariance = outcomes[i].covariance;
    covariance.topRows<3>() /= unit;
    covariance.leftCols<3>() /= unit;
    EXPECT_LT(difference(outcomes[0].covariance, covariance), 0.01);
  }
}

TEST(DevicePose, TakesOutABendThatIsProven) {
  ICLK_NEED_DEVICE();
  std::mt19937_64 random(17);
  std::vector<Case> cases;
  for (const Eigen::Vector3d& turn :
       {Eigen::Vector3d(0.009, 0.006, -0.008), {0, 0.02, 0}, {-0.004, 0, 0.03}, {0.0018, 0, 0}, {0, 0, 0}}) {
    const test::BentPair pair(turn, 0.01, 0.2, random);
    cases.push_back({pair.camera, pair.features, pair.aligned, pair.T_10});
  }
  RefinerOptions global;
  global.rolling_shutter = false;
  const auto outcomes = run(cases), as_they_are = run(cases, global);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const Case& c = cases[i];
    const PoseResult bent = refine_pose(c.camera, c.features, c.aligned, c.T_10);
    const auto found = internal::pair_turn(c.camera, c.features, c.aligned, bent.T_10);
    ASSERT_TRUE(found);
    ASSERT_EQ(found->proven(c.camera), i < 3);
    const Eigen::Vector3d turn(outcomes[i].info.turn[0], outcomes[i].info.turn[1], outcomes[i].info.turn[2]);
    EXPECT_EQ(outcomes[i].info.rounds, 1u);
    if (bent.converged()) {
      EXPECT_LT(motion(c, as_they_are[i].T_10, bent.T_10), 0.03);  // what does not fit has a flat minimum
    }
    EXPECT_EQ(as_they_are[i].info.turn[1], 0);
    if (!found->proven(c.camera)) {
      EXPECT_EQ(turn, Eigen::Vector3d::Zero());
      const Matrix6d expected = bent.covariance + found->doubt(bent.T_10);
      EXPECT_LT(difference(expected, outcomes[i].covariance), 0.03);
      if (i == 3) {
        EXPECT_GT(difference(expected, as_they_are[i].covariance), 0.2);
      }
      EXPECT_EQ(std::memcmp(outcomes[i].info.pose, as_they_are[i].info.pose, sizeof outcomes[i].info.pose), 0);
      continue;
    }
    EXPECT_LT((turn - found->turn).norm(), 2e-5);
    std::vector<AlignedFeature> straight = c.aligned;
    for (AlignedFeature& f : straight) f.uv1 = internal::unrolled(c.camera, found->turn, f.uv1);
    const PoseResult expected = refine_pose(c.camera, c.features, straight, found->T_10);
    EXPECT_LT(motion(c, outcomes[i].T_10, expected.T_10), 5e-3);
    EXPECT_NEAR(outcomes[i].info.inliers, expected.inliers, 1);
    EXPECT_LT(difference(expected.covariance + found->pose_share, outcomes[i].covariance), 0.03);
  }
}

TEST(DevicePose, RefusesWhatTheHostRefuses) {
  ICLK_NEED_DEVICE();
  const Scene scene = test::wide_scene();
  std::vector<Case> cases;
  std::vector<Status> expected;
  cases.push_back(case_of(scene, 60, 0.1, 0, 1));  // nothing was found: its texture may have been hidden
  for (size_t i = 3; i < cases.back().aligned.size(); ++i) cases.back().aligned[i].status = FeatureStatus::bad_match;
  expected.push_back(Status::diverged);
  cases.push_back(case_of(scene, 60, 0.1, 0, 2));
  for (AlignedFeature& a : cases.back().aligned) a.status = FeatureStatus::low_texture;
  expected.push_back(Status::too_few_features);
  cases.push_back(case_of(scene, 60, 0.1, 1, 3));  // every position is wrong
  expected.push_back(Status::diverged);
  cases.push_back(case_of(scene, 60, 0.1, 0, 4));  // one place seen sixty times determines nothing
  for (size_t i = 1; i < 60; ++i) {
    cases.back().features.uv[i] = cases.back().features.uv[0];
    cases.back().features.inverse_depth[i] = cases.back().features.inverse_depth[0];
    cases.back().aligned[i] = cases.back().aligned[0];
  }
  expected.push_back(Status::degenerate);
  cases.push_back(case_of(scene, 60, 0.1, 0, 8));  // on one edge, 2 px wide
  for (size_t i = 0; i < 60; ++i) {
    Eigen::Vector2d& uv = cases.back().features.uv[i];
    uv.y() = 100 + 0.3 * uv.x() + 0.1 * static_cast<double>(i % 20);
    cases.back().features.inverse_depth[i] = 1 / scene.depth(uv);
    cases.back().aligned[i].uv1 = scene.truth(uv);
  }
  expected.push_back(Status::degenerate);
  cases.push_back(case_of(scene, 60, 0.1, 0, 5));  // 45 px from what ICLK found
  cases.back().T_10 = scene.T_10 * SE3::exp((Vector6d() << 0, 0, 0, 0.1, 0, 0).finished());
  expected.push_back(Status::diverged);
  cases.push_back(case_of(scene, 60, 0.1, 0, 6));  // NaN where it must not matter, and where it must
  cases.back().features.uv[0].x() = std::nan("");
  cases.back().aligned[1].uv1.x() = std::nan("");
  cases.back().aligned[2].covariance(0, 0) = std::nan("");
  expected.push_back(Status::converged);
  const auto outcomes = run(cases);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    // Where nothing is determined, rounding decides whether the descent ends or leaves: both are refused.
    const bool leaves = expected[i] == Status::degenerate && outcomes[i].info.status == static_cast<uint32_t>(Status::diverged);
    if (!leaves) {
      EXPECT_EQ(outcomes[i].info.status, static_cast<uint32_t>(expected[i]));
    }
    EXPECT_EQ(outcomes[i].info.refined, expected[i] == Status::converged ? 1u : 0u);
    EXPECT_TRUE(outcomes[i].covariance.allFinite());
    if (expected[i] == Status::converged) continue;
    EXPECT_TRUE(outcomes[i].covariance.isZero());
    EXPECT_LT(motion(cases[i], outcomes[i].T_10, cases[i].T_10), 1e-3);  // ICLK's
  }
  EXPECT_EQ(outcomes.back().info.used, 57u);
}

TEST(DevicePose, UnconfirmedPosesKeepIclksCovarianceAndThatOfTheDepths) {
  ICLK_NEED_DEVICE();
  Case c = case_of(test::wide_scene(), 60, 0.1, 0, 1);
  for (AlignedFeature& a : c.aligned) a.status = FeatureStatus::bad_match;
  c.iclk_covariance = 1e-6 * Matrix6d::Identity();
  c.features.inverse_depth_sigma.assign(60, 0.01 * c.features.inverse_depth[0]);
  RefinerOptions options;
  options.keep_unconfirmed = true;
  const Outcome o = run({c}, options)[0];
  EXPECT_EQ(o.info.status, static_cast<uint32_t>(Status::converged));
  EXPECT_EQ(o.info.refined, 0u);
  const Matrix6d expected =
      c.iclk_covariance +
      internal::depth_covariance(c.camera, c.features, check_features(c.features, c.camera), c.T_10, 0, ICLK_MAP_SIGMA);
  EXPECT_GT(difference(expected, c.iclk_covariance), 0.1);
  EXPECT_LT(difference(expected, o.covariance), 0.02);
}

// Up to six of ten depths are wrong by factors from a third to three: a descent alone loses some of these poses.
TEST(DevicePose, RightDepthsOutvoteWrongOnes) {
  ICLK_NEED_DEVICE();
  const Scene scene = deep_scene();
  constexpr double kNoise = 0.02;
  std::vector<Case> cases;
  for (const double share : {0.3, 0.5, 0.6})
    for (uint32_t seed = 0; seed < 12; ++seed) {
      Case c = case_of(scene, 100, kNoise, 0, 20 + seed);
      std::mt19937 random(seed);
      std::uniform_real_distribution<double> uniform(0, 1);
      for (size_t i = 0; i < 100; ++i) {
        double& q = c.features.inverse_depth[i];
        q *= 0.5 + 1.5 * uniform(random);  // no plane
        c.aligned[i].covariance = 1e-4 * Eigen::Matrix2d::Identity();
        c.aligned[i].uv1 = c.camera.project(scene.T_10 * (c.camera.ray(c.features.uv[i]) / q)) +
                           kNoise * Eigen::Vector2d(uniform(random), uniform(random));
        if (uniform(random) < share) q *= std::exp(std::log(3) * (2 * uniform(random) - 1));
      }
      c.T_10 = scene.T_10 * SE3::exp((Vector6d() << 1.8, -1.8, 1.2, 0.024, -0.024, 0.06).finished());
      cases.push_back(c);
    }
  RefinerOptions options;
  options.rolling_shutter = false;
  const auto outcomes = run(cases, options);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const Case& c = cases[i];
    const PoseResult expected = refine_pose(c.camera, c.features, c.aligned, c.T_10);
    EXPECT_EQ(outcomes[i].state.status, static_cast<uint32_t>(expected.status));
    EXPECT_LT(motion(c, expected.T_10, scene.T_10), 0.1);
    SE3 found = test::unpack_pose(outcomes[i].state.pose);
    found.t /= internal::unit_of(c.features);
    EXPECT_LT(motion(c, found, expected.T_10), 5e-3);
  }
}

// Enough were found, and most of them elsewhere: only a first guess may overrule that.
TEST(DevicePose, FeaturesRefuteAPoseThatWasSearchedFor) {
  ICLK_NEED_DEVICE();
  Case searched = case_of(test::wide_scene(), 60, 0.1, 0, 1);
  for (size_t i = 0; i < 45; ++i)
    searched.aligned[i].uv1 += Eigen::Vector2d(i % 2 ? 40 : -40, 7.0 * static_cast<double>(i) - 160);
  Case guessed = searched, unseen = searched;
  guessed.search = false;
  for (size_t i = 0; i < 45; ++i) unseen.aligned[i].status = FeatureStatus::bad_match;
  RefinerOptions options;
  options.keep_unconfirmed = true;
  const auto outcomes = run({searched, guessed, unseen}, options);
  EXPECT_EQ(outcomes[0].info.status, static_cast<uint32_t>(Status::diverged));
  EXPECT_TRUE(outcomes[0].covariance.isZero());
  EXPECT_EQ(outcomes[1].info.status, static_cast<uint32_t>(Status::converged));
  EXPECT_EQ(outcomes[2].info.status, static_cast<uint32_t>(Status::converged));
  for (const Outcome& o : outcomes) EXPECT_EQ(o.info.refined, 0u);
}

}  // namespace
}  // namespace iclk
