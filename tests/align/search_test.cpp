// The start search: motions far outside the basin are found, by every solver alike.
#include <iclk/align/search/search.h>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

AlignerOptions searching() {
  AlignerOptions options;
  options.levels = 3;
  options.search.enabled = true;
  options.search.matching = false;  // matching_test.cpp
  return options;
}

// A turn of 0.15 to 0.2 rad about a tilted axis: 20 to 26 px of 160, where a basin of 3 levels has about 12.
std::vector<Relief> far_scenes(int n) {
  std::vector<Relief> scenes(static_cast<size_t>(n));
  for (int i = 0; i < n; ++i) {
    Relief& scene = scenes[static_cast<size_t>(i)];
    scene.seed = static_cast<uint32_t>(i) + 1;
    const double turn = 2 * M_PI * i / n, size = 0.15 + 0.05 * (i % 2);
    Vector6d xi;
    xi << 0.05, -0.03, 0.04, size * std::cos(turn), size * std::sin(turn), 0.05 * (i % 3 - 1);
    scene.T_10 = SE3::exp(xi);
  }
  return scenes;
}

class Search : public Solvers {};

TEST_P(Search, FindsWhatIsFarOutsideTheBasin) {
  const auto scenes = far_scenes(8);
  Plan plan = plan_for(scenes[0].camera);
  plan.max_references = plan.max_pairs = 8;
  AlignerOptions off = searching();
  off.search.enabled = false;
  const auto with = make_aligner(way(), plan, searching()), without = make_aligner(way(), plan, off);
  std::vector<Frame> targets;
  std::vector<Features> features;
  std::vector<Pair> pairs;
  for (int i = 0; i < 8; ++i) {
    const Relief& scene = scenes[static_cast<size_t>(i)];
    features.push_back(random_features(scene, 50));
    const Frame image0 = render(scene, 0);
    for (Aligner* aligner : {with.get(), without.get()})
      aligner->set_reference(i, {image0.view(), scene.camera, features.back(), {}});
    targets.push_back(render(scene, 1));
  }
  for (int i = 0; i < 8; ++i) pairs.push_back({i, targets[static_cast<size_t>(i)].view(), {}, {}});
  const auto found = with->align(pairs), lost = without->align(pairs);
  int missed = 0;
  for (size_t i = 0; i < 8; ++i) {
    EXPECT_TRUE(found[i].converged()) << i << ": " << found[i].reason;
    EXPECT_LT(pixel_error(scenes[i], features[i], found[i].T_10), 0.1) << i;
    missed += !lost[i].converged();
  }
  EXPECT_GE(missed, 4) << "not far enough to need a search";
}

// The search decides by comparing, so that solvers agree as long as no two starts are equally good.
TEST_P(Search, StartsWhereTheCpuReferenceDoes) {
  const Relief scene = far_scenes(8)[3];
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  AlignerOptions options = searching();
  const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, options);
  const Alignment a = align_once(way(), scene, image0, image1, features, options);
  ASSERT_FALSE(a.levels.empty() || a.levels[0].iterations.empty());
  EXPECT_LT(distance(a.levels[0].iterations[0].T_10, expected.levels[0].iterations[0].T_10, scene.distance), 1e-3);
  EXPECT_LT(distance(a.T_10, expected.T_10, scene.distance), 1e-5);
}

TEST_P(Search, IsAboutTheFirstGuess) {
  Relief scene;
  Vector6d xi = Vector6d::Zero();
  xi(4) = 0.5;  // 70 px: beyond every start about the identity
  scene.T_10 = SE3::exp(xi);
  const Features features = random_features(scene, 80);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  xi(4) = 0.3;
  const Alignment a = align_once(way(), scene, image0, image1, features, searching(), SE3::exp(xi));
  EXPECT_TRUE(a.converged()) << a.reason;
  EXPECT_LT(pixel_error(scene, features, a.T_10), 0.2);
  AlignerOptions options = searching();
  options.search.grid = 1;
  options.search.roll = 0;
  options.search.screened = options.search.kept = 1;
  const Alignment alone = align_once(way(), scene, image0, image0, features, options);
  EXPECT_TRUE(alone.converged()) << alone.reason;
  EXPECT_LT(alone.T_10.log().norm(), 1e-6);
}

// Of many features some take part, from all of their list: here those at its beginning are of no use.
TEST_P(Search, OfManyFeaturesSomeOfAllTakePart) {
  const Relief scene = far_scenes(8)[3];
  Features features = random_features(scene, 250);
  std::fill_n(features.inverse_depth.begin(), 150, 0.0);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Alignment a = align_once(way(), scene, image0, image1, features, searching());
  EXPECT_TRUE(a.converged()) << a.reason;
  EXPECT_LT(pixel_error(scene, features, a.T_10), 0.1);
  const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, searching());
  EXPECT_LT(distance(a.levels[0].iterations[0].T_10, expected.levels[0].iterations[0].T_10, scene.distance), 1e-3);
}

// Of more than ICLK_SEARCH_WHOLE features every second row. Noise makes other rows another start.
TEST_P(Search, TakesTheRowsOfTheCpuReference) {
  const Relief scene = far_scenes(8)[3];
  Frame images[] = {render(scene, 0), render(scene, 1)};
  std::mt19937 random(1);
  std::normal_distribution<float> noise(0, 0.05f);
  for (Frame& image : images)
    for (float& x : image.data) x += noise(random);
  for (const int count : {20, 40, 70}) {
    const Features features = random_features(scene, count);
    const auto start = [&](Way way) {
      return align_once(way, scene, images[0], images[1], features, searching()).levels.at(0).iterations.at(0).T_10;
    };
    EXPECT_LT(distance(start(way()), start(Way::cpu), scene.distance), 1e-5) << count << " features";
  }
}

// Where no start sees enough the guess stays, and the verdict is the alignment's.
TEST_P(Search, WithoutAnyUsableStartTheGuessStays) {
  const Relief scene;
  SE3 away;
  away.t.x() = 100;
  const Frame image = render(scene, 0);
  const Alignment a = align_once(way(), scene, image, image, random_features(scene, 50), searching(), away);
  EXPECT_EQ(a.status, Status::low_overlap) << a.reason;
  EXPECT_NEAR(a.T_10.t.x(), 100, 1e-3);
}

INSTANTIATE_TEST_SUITE_P(All, Search, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

TEST(SearchStarts, AreTheGuessAndAGridAboutIt) {
  AlignerOptions options;
  options.levels = 4;
  options.search.grid = 5;
  options.search.rotation = 0.2;
  SE3 guess;
  guess.t.x() = 1;
  const Camera camera{500, 500, 320, 240, 640, 480};
  auto starts = internal::search_starts(guess, camera, options);
  ASSERT_EQ(starts.size(), 75u);
  EXPECT_EQ(static_cast<int>(starts.size()), options.search.starts());
  EXPECT_LT((starts[0].matrix() - guess.matrix()).norm(), 1e-12);
  double largest = 0;
  for (size_t i = 0; i < starts.size(); ++i) {
    const Vector6d turn = (starts[i] * guess.inverse()).log();
    EXPECT_LT(turn.head<3>().norm(), 1e-9) << "the camera turns about itself";
    largest = std::max(largest, std::abs(turn(3)));
    for (size_t j = 0; j < i; ++j) EXPECT_GT(distance(starts[i], starts[j], 1), 0.05) << i << ", " << j;
  }
  EXPECT_NEAR(largest, 0.2, 0.01);
  options.search.rotation = 0;
  starts = internal::search_starts({}, camera, options);
  EXPECT_NEAR((starts[1].inverse() * starts[2]).log().norm(), 3.4 * 8 / 500, 1e-3);
}

TEST(SearchRecording, TheSameCommandsSearchAgain) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const auto scenes = far_scenes(8);
  Plan plan = plan_for(scenes[0].camera);
  DeviceAligner aligner(context, plan, searching(), Solver::device);
  const Features features = random_features(scenes[2], 50);
  const Frame image0 = render(scenes[2], 0), image1 = render(scenes[2], 1);
  aligner.set_reference(0, {image0.view(), scenes[2].camera, features, {}});
  ApplicationImage image(app, 160, 120, VK_FORMAT_R32_SFLOAT, VK_IMAGE_LAYOUT_GENERAL);
  const auto recording = aligner.make_recording();
  const ApplicationCommands host(app);
  const DevicePair pair{0, image.foreign, {}, {}};
  aligner.record(*recording, host.commands, {}, {&pair, 1});
  host.end();
  SE3 first;
  for (int run = 0; run < 3; ++run) {
    image.fill(context, run == 1 ? image0.data.data() : image1.data.data(), 4 * image1.data.size());
    host.submit_and_wait();
    const Alignment a = recording->read().at(0);
    EXPECT_TRUE(a.converged()) << a.reason;
    if (run == 0) first = a.T_10;
    if (run == 1) {
      EXPECT_LT(a.T_10.log().norm(), 1e-5);
    } else {
      EXPECT_LT(pixel_error(scenes[2], features, a.T_10), 0.1) << run;
      EXPECT_EQ(a.T_10.t, first.t);
    }
  }
}

}  // namespace
}  // namespace iclk::test
