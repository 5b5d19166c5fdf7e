#include "apps/iclk/session/run_pairs.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgcodecs.hpp>

#include <iclk/session/io/distortion.h>
#include <iclk/session/pose_errors.h>

#include "apps/iclk/io/sequence.h"
#include "apps/iclk/session/report.h"
#include "apps/iclk/sets/scene.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;

PairInput scene_input(int width = 320, int height = 240) {
  SceneOptions options;
  options.width = width;
  options.height = height;
  Vector6d xi;
  xi << 0.02, -0.01, 0.02, 0.01, 0.015, -0.02;
  const ScenePair scene = make_scene_pair(SE3::exp(xi), options);
  PairInput pair;
  pair.image_0 = scene.image_0;
  pair.image_1 = scene.image_1;
  pair.depth_0 = scene.depth_0;
  pair.camera = scene.camera;
  pair.truth = scene.T_10;
  detect_missing_features(pair, {});
  return pair;
}

/// The classical mode without a search.
SessionOptions options_of(Solver solver) { return {.solver = solver, .stages = {{}}}; }
SessionOptions cpu_options() { return options_of(Solver::cpu); }

/// Every number is finite, or the value is null.
void expect_finite(const nlohmann::ordered_json& value) {
  if (value.is_number_float()) {
    EXPECT_TRUE(std::isfinite(value.get<double>()));
  }
  if (value.is_structured())
    for (const auto& child : value) expect_finite(child);
}

void expect_matrix(const nlohmann::ordered_json& value, size_t n) {
  ASSERT_TRUE(value.is_array());
  ASSERT_EQ(value.size(), n);
  for (const auto& row : value) EXPECT_EQ(row.size(), n);
}

TEST(Session, FindsTheTruthAndReportsIt) {
  const PairInput pair = scene_input();
  Session session(cpu_options());
  const RefinedAlignment result = run_pair(session, pair);
  ASSERT_TRUE(result.converged()) << result.reason;
  EXPECT_LT(pose_error(pair.camera, pair.features, result.T_10, *pair.truth).e_pixel, 0.2);

  const auto json = to_json(pair, result, session);
  for (const char* key : {"status", "T_10", "covariance", "stages", "levels", "features", "visible_fraction", "correlation",
                          "agreement", "device", "timing_ms"})
    EXPECT_TRUE(json.contains(key)) << key;
  EXPECT_EQ(json["status"], "converged");
  EXPECT_GT(json["agreement"].get<double>(), 0.1);
  expect_matrix(json["T_10"], 4);
  expect_matrix(json["covariance"], 6);
  EXPECT_GT(json["covariance"][0][0].get<double>(), 0);
  for (int r = 0; r < 3; ++r) EXPECT_EQ(json["T_10"][static_cast<size_t>(r)][3].get<double>(), result.T_10.t[r]) << "row-major";
  ASSERT_EQ(json["stages"].size(), 4u);
  const char* names[] = {"iclk", "feature_alignment", "pose", "rivals"};
  for (size_t i = 0; i < 4; ++i) {
    const auto& stage = json["stages"][i];
    EXPECT_EQ(stage["name"], names[i]);
    expect_matrix(stage["T_10"], 4);
    for (const char* key : {"cost", "ms", "e_pixel", "e_transl", "e_rot"}) EXPECT_TRUE(stage[key].is_number()) << key;
  }
  EXPECT_EQ(json["levels"].size(), 4u);
  EXPECT_EQ(json["levels"][0]["level"], 3);
  ASSERT_EQ(json["features"].size(), static_cast<size_t>(pair.features.size()));
  for (const char* key : {"u0", "v0", "inverse_depth", "u1", "v1", "status"})
    EXPECT_TRUE(json["features"][0].contains(key)) << key;
  expect_finite(json);
  EXPECT_EQ(to_json(pair, result, session).dump(), json.dump());

  const std::string table = to_table(pair, result, session);
  EXPECT_NE(table.find("converged"), std::string::npos);
  EXPECT_EQ(table.find("hint"), std::string::npos);
}

bool has_device() {
  try {
    const auto devices = engine::list_devices();
    return std::any_of(devices.begin(), devices.end(), [](const auto& d) { return d.rejected.empty(); });
  } catch (const Error&) {
    return false;
  }
}

TEST(Session, EverySolverGivesThePose) {
  if (!has_device()) GTEST_SKIP() << "no Vulkan device on this machine";
  const PairInput pair = scene_input();
  PairInput blank = pair, foreign = pair;
  blank.image_0 = blank.image_1 = cv::Mat(240, 320, CV_8UC1, cv::Scalar(90));
  foreign.image_1 = cv::Mat(240, 320, CV_8UC3);
  cv::RNG random(5);
  random.fill(foreign.image_1, cv::RNG::UNIFORM, 0, 255);
  Session cpu(cpu_options());
  const RefinedAlignment expected = run_pair(cpu, pair);
  for (const Solver solver : {Solver::host, Solver::device}) {
    SessionOptions options = options_of(solver);
    options.profile = true;
    Session session(options);
    EXPECT_NE(session.device_name(), cpu.device_name());
    const RefinedAlignment result = run_pair(session, pair);
    ASSERT_TRUE(result.converged()) << result.reason;
    EXPECT_LT(pose_error(pair.camera, pair.features, result.T_10, expected.T_10).e_pixel, 0.01);
    EXPECT_EQ(run_pair(session, pair).T_10.matrix(), result.T_10.matrix()) << "two runs, the same bits";
    EXPECT_NE(profile_text(session, pair).find("pyramid"), std::string::npos) << profile_text(session, pair);
    EXPECT_EQ(run_pair(session, blank).status, run_pair(cpu, blank).status);
    EXPECT_FALSE(run_pair(session, foreign).converged());
  }
}

TEST(Session, ADeviceThatIsNotThereIsNamed) {
  try {
    Session session({.model = "classical", .device = "No Such Device"});
    ADD_FAILURE() << "no error";
  } catch (const Error& e) {
    EXPECT_TRUE(e.code() == ErrorCode::no_device || e.code() == ErrorCode::no_driver) << e.what();
  }
}

TEST(Session, WithoutTruthThereAreNoErrors) {
  PairInput pair = scene_input();
  pair.truth.reset();
  Session session(cpu_options());
  const auto json = to_json(pair, run_pair(session, pair), session);
  EXPECT_FALSE(json["stages"][0].contains("e_pixel"));
}

TEST(Session, WithoutRefinementThereIsOneStage) {
  const PairInput pair = scene_input();
  SessionOptions options = cpu_options();
  options.refine = false;
  Session session(options);
  const RefinedAlignment result = run_pair(session, pair);
  ASSERT_TRUE(result.converged()) << result.reason;
  const auto json = to_json(pair, result, session);
  ASSERT_EQ(json["stages"].size(), 1u);
  EXPECT_EQ(json["features"][0]["status"], "projected");
}

TEST(Session, AFailureHasNullsAndAHint) {
  PairInput pair = scene_input();
  pair.features.uv.resize(3);
  pair.features.inverse_depth.resize(3);
  pair.features.inverse_depth[0] = NAN;
  Session session(cpu_options());
  const RefinedAlignment result = run_pair(session, pair);
  EXPECT_EQ(result.status, Status::too_few_features);
  const auto json = to_json(pair, result, session);
  expect_finite(json);
  EXPECT_TRUE(json["covariance"][0][0].is_null()) << "no covariance is not a covariance of zero";
  EXPECT_TRUE(json["features"][0]["inverse_depth"].is_null());
  EXPECT_EQ(json["features"][0]["status"], "not_finite");
  EXPECT_NE(to_table(pair, result, session).find("hint"), std::string::npos);
}

TEST(Session, OtherSizesAndMoreFeaturesMakeNewPlans) {
  Session session(cpu_options());
  EXPECT_TRUE(run_pair(session, scene_input()).converged());
  EXPECT_TRUE(run_pair(session, scene_input(400, 300)).converged());
  PairInput pair = scene_input(400, 300);
  pair.features = {};
  DetectorOptions many;
  many.count = 120;
  detect_missing_features(pair, many);
  EXPECT_TRUE(run_pair(session, pair).converged());
}

TEST(Session, BatchesGiveWhatSinglesGive) {
  const PairInput a = scene_input();
  PairInput b = a;
  std::swap(b.image_0, b.image_1);
  b.T_10 = a.truth->inverse();
  const std::vector<PairInput> pairs = {a, b, a};
  SessionOptions options = cpu_options();
  options.batch = 2;
  Session session(options), single(cpu_options());
  const std::vector<RefinedAlignment> results = run_pairs(session, pairs);
  ASSERT_EQ(results.size(), 3u);
  for (size_t i = 0; i < 3; ++i) EXPECT_EQ(results[i].T_10.matrix(), run_pair(single, pairs[i]).T_10.matrix()) << i;
}

TEST(Session, NothingIsSearchedWhereAGuessWasGiven) {
  PairInput plain = scene_input(), guessed = plain;
  guessed.T_10 = *plain.truth;
  guessed.T_10->t.x() += 0.01;
  const auto pose = [](SearchMode search, const PairInput& pair) {
    Session session({.model = "classical", .solver = Solver::cpu, .search = search});
    return run_pair(session, pair).iclk.T_10.matrix();
  };
  EXPECT_EQ(pose(SearchMode::automatic, guessed), pose(SearchMode::off, guessed));
  EXPECT_NE(pose(SearchMode::on, guessed), pose(SearchMode::off, guessed));
  EXPECT_EQ(pose(SearchMode::automatic, plain), pose(SearchMode::on, plain));
}

TEST(Session, DeepAndGreyImages) {
  for (const int depth : {CV_16U, CV_32F}) {
    PairInput pair = scene_input();
    pair.image_0 = grey_8bit(pair.image_0);
    pair.image_0.convertTo(pair.image_0, depth, depth == CV_16U ? 257 : 1 / 255.0);
    pair.image_1.convertTo(pair.image_1, depth, depth == CV_16U ? 257 : 1 / 255.0);
    Session session(cpu_options());
    EXPECT_TRUE(run_pair(session, pair).converged());
  }
}

TEST(Session, DenseNeedsADepthImage) {
  PairInput pair = scene_input();
  SessionOptions options = cpu_options();
  options.dense = true;
  Session session(options);
  const RefinedAlignment result = run_pair(session, pair);
  EXPECT_TRUE(result.converged()) << result.reason;
  EXPECT_LT(pose_error(pair.camera, pair.features, result.T_10, *pair.truth).e_pixel, 0.2);
  pair.depth_0 = cv::Mat();
  expect_error([&] { run_pair(session, pair); }, ErrorCode::invalid_argument, {"--set dense=yes", "--depth"});
}

TEST(PairLoader, SizesMustAgree) {
  const Folder folder;
  cv::imwrite(folder.path("a.png"), cv::Mat(60, 80, CV_8UC1, cv::Scalar(9)));
  cv::imwrite(folder.path("b.png"), cv::Mat(60, 81, CV_8UC1, cv::Scalar(9)));
  cv::imwrite(folder.path("d.png"), cv::Mat(61, 80, CV_16UC1, cv::Scalar(900)));
  InputOptions options;
  options.camera = load_camera("50,50,39.5,29.5");
  options.depth_scale = 1000;
  const PairLoader loader(options);
  expect_error(
      [&] {
        loader.load({folder.path("a.png"), folder.path("b.png"), folder.path("d.png"), ""});
      },
      ErrorCode::invalid_argument, {"b.png", "81x60", "80x60"});
  expect_error(
      [&] {
        loader.load({folder.path("a.png"), folder.path("a.png"), folder.path("d.png"), ""});
      },
      ErrorCode::invalid_argument, {"d.png", "80x61", "80x60"});
  expect_error(
      [&] {
        loader.load({folder.path("a.png"), folder.path("a.png"), "", ""});
      },
      ErrorCode::invalid_argument, {"--depth", "--features"});
  options.camera = load_camera("50,50,39.5,29.5,640,360");
  expect_error(
      [&] {
        PairLoader(options).load({folder.path("a.png"), folder.path("a.png"), folder.path("d.png"), ""});
      },
      ErrorCode::invalid_argument, {"640x360", "80x60"});
}

TEST(PairLoader, FeaturesAreUndistortedAtTheDoor) {
  const Folder folder;
  cv::imwrite(folder.path("a.png"), cv::Mat(240, 320, CV_8UC1, cv::Scalar(9)));
  InputOptions options;
  options.camera = load_camera("300,300,159.5,119.5");
  options.distortion = parse_distortion("radtan:0.5,0,0,0");
  // x = 0.2: distorted to 0.2 (1 + 0.5 * 0.04) = 0.204.
  const PairInput pair = PairLoader(options).load(
      {folder.path("a.png"), folder.path("a.png"), "", folder.write("f.csv", "u,v,depth\n220.7,119.5,2\n")});
  EXPECT_NEAR(pair.features.uv[0].x(), 159.5 + 300 * 0.2, 1e-3);
  EXPECT_NEAR(pair.features.uv[0].y(), 119.5, 1e-6);
}

TEST(Session, RealPairsMeetTheIssue) {
  const std::string folder = test::data_folder("tum_fr1_360_5");
  if (folder.empty()) GTEST_SKIP() << test::no_data("tum_fr1_360_5");
  const Sequence sequence = load_sequence(folder);
  const auto pairs = make_pairs(sequence, 1);
  ASSERT_EQ(pairs.size(), 4u);
  for (const Solver solver : {Solver::cpu, Solver::host, Solver::device})
    for (const bool undistort : {false, true}) {
      if (solver != Solver::cpu && !has_device()) continue;
      SCOPED_TRACE(testing::Message() << "solver " << static_cast<int>(solver) << (undistort ? ", undistorted" : ""));
      InputOptions options;
      options.camera = *sequence.camera;
      options.detector.count = 50;  // the bounds are of the paper's 50
      if (undistort) options.distortion = parse_distortion("radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633");
      const PairLoader loader(options);
      Session session(options_of(solver));
      double degrees = 0, mm = 0;
      for (int i = 0; i < 4; ++i) {
        const SequencePair& p = pairs[static_cast<size_t>(i)];
        const PairInput pair = loader.load({p.reference, p.target, p.depth, ""});
        const RefinedAlignment result = run_pair(session, pair);
        EXPECT_TRUE(result.converged()) << i << ": " << result.reason;
        const PoseError e = pose_error(pair.camera, pair.features, result.T_10, *p.T_10);
        if (i < 3)
          degrees += e.e_rot * 180 / M_PI / 3, mm += 1e3 * e.e_transl / 3;
        else
          EXPECT_LE(e.e_rot * 180 / M_PI, 0.60);
      }
      EXPECT_LE(degrees, undistort ? 0.20 : 0.25);
      EXPECT_LE(mm, undistort ? 3.5 : 6.5);
    }
}

TEST(Session, RollingShuttersAreSeenInRealPairsAndNotInRenderedOnes) {
  const std::string kinect = test::data_folder("tum_fr1_360_5"), rendered = test::data_folder("tartan_60");
  if (kinect.empty() || rendered.empty()) GTEST_SKIP() << test::no_data("tum_fr1_360_5 or tartan_60");
  SessionOptions session_options = options_of(has_device() ? Solver::device : Solver::cpu);
  const Sequence turning = load_sequence(kinect);
  const auto error_of = [&](const Sequence& sequence, const SequencePair& p, bool rolling, bool& turned) {
    InputOptions options;
    options.camera = *sequence.camera;
    session_options.refiner.rolling_shutter = rolling;
    const PairInput pair = PairLoader(options).load({p.reference, p.target, p.depth, ""});
    Session session(session_options);
    const RefinedAlignment result = run_pair(session, pair);
    EXPECT_TRUE(result.converged() || &sequence != &turning) << result.reason;
    turned = result.turn.has_value();
    return pose_error(pair.camera, pair.features, result.T_10, *p.T_10);
  };
  const auto pairs = make_pairs(turning, 1);
  ASSERT_EQ(pairs.size(), 4u);
  bool turned = false;
  EXPECT_LE(error_of(turning, pairs[0], true, turned).e_rot * 180 / M_PI, 0.17);
  EXPECT_FALSE(turned);                                                // as fast before as after
  const PoseError rolled = error_of(turning, pairs[3], true, turned);  // brakes from 3.5 to 2.7 degrees a frame
  EXPECT_TRUE(turned);
  const PoseError plain = error_of(turning, pairs[3], false, turned);
  EXPECT_FALSE(turned);
  EXPECT_LE(rolled.e_rot * 180 / M_PI, 0.45);
  EXPECT_LT(rolled.e_rot, 0.7 * plain.e_rot);
  EXPECT_LT(rolled.e_transl, 0.7 * plain.e_transl);

  const Sequence exact = load_sequence(rendered);
  for (const int stride : {1, 3}) {
    const auto all = make_pairs(exact, stride);
    for (size_t i = 0; i < all.size(); i += 8) {
      error_of(exact, all[i], true, turned);
      EXPECT_FALSE(turned) << stride << " " << i;
    }
  }
}

}  // namespace
}  // namespace iclk
