#include "apps/eval/bench/runs.h"

#include <limits>
#include <set>

#include <opencv2/imgproc.hpp>

#include <iclk/align/common/stopwatch.h>
#include <iclk/session/pose_errors.h>

#include "apps/eval/peers/methods.h"
#include "apps/iclk/common/cpu_stopwatch.h"
#include "apps/iclk/common/median.h"
#include "apps/json/json.h"
#include "device.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;

const Progress kQuiet = [](const std::string&, int, int) {};

BenchOptions tiny() {
  BenchOptions options;
  options.pairs = {1, 2};
  options.repetitions = 1;
  options.width = 320;
  options.height = 240;
  options.profile = true;
  return options;
}

TEST(BenchMeasure, Median) {
  EXPECT_EQ(median({3, 1, 2}), 2);
  EXPECT_EQ(median({4, 1, 2, 3}), 2.5);
  EXPECT_EQ(median({1, std::numeric_limits<double>::infinity(), 2}), 2) << "a failure sorts last";
  EXPECT_TRUE(std::isnan(median({})));
  EXPECT_TRUE(number(std::numeric_limits<double>::infinity()).is_null());
  EXPECT_EQ(number(1.5), 1.5);
}

TEST(BenchMeasure, ProcessorTimeGrowsWithWork) {
  const internal::Stopwatch wall;
  const CpuStopwatch cpu;
  volatile double x = 1;
  while (cpu.ms() < 20) x = x * 1.0000001;
  EXPECT_GE(wall.ms(), 5);  // one thread cannot be faster than itself, but the clocks tick coarsely
}

TEST(Bench, OptionsAreNamedWhenWrong) {
  BenchOptions options;
  options.pairs = {1, 0};
  expect_error([&] { options.check(); }, ErrorCode::invalid_argument, {"--pairs 0"});
  options = {};
  options.repetitions = 0;
  expect_error([&] { options.check(); }, ErrorCode::invalid_argument, {"--repetitions 0"});
  options = {};
  options.only = {"everything"};
  expect_error([&] { options.check(); }, ErrorCode::invalid_argument, {"everything", "'device'", "'RgbdOdometry'"});
  options = {};
  options.width = 8;
  expect_error([&] { options.check(); }, ErrorCode::invalid_argument, {"8x480"});
}

TEST(Bench, PairsAreDistinctAndTheirTruthHolds) {
  BenchOptions options = tiny();
  const std::vector<PeerPair> pairs = make_bench_pairs({options.width, options.height, options.features}, 10, kQuiet);
  ASSERT_EQ(pairs.size(), 10u);
  std::set<const void*> memory;
  for (const PeerPair& pair : pairs) {
    memory.insert({pair.grey_0.data, pair.grey_1.data});
    ASSERT_GE(pair.features.size(), 40);
    // What feature i shows in image 0 shows at its true place in image 1, darker: mirrored poses and depths must fit their
    // images.
    double off = 0, unmoved = 0;
    int count = 0;
    for (int i = 0; i < pair.features.size(); ++i) {
      Eigen::Vector2d uv1;
      if (!project_feature(pair.camera, pair.features, i, pair.T_10, uv1)) continue;
      cv::Mat patch_0, patch_1, patch_unmoved;
      const Eigen::Vector2d uv0 = pair.features.uv[static_cast<size_t>(i)];
      const auto take = [](const cv::Mat& image, const Eigen::Vector2d& uv, cv::Mat& patch) {
        cv::getRectSubPix(image, {9, 9}, {static_cast<float>(uv.x()), static_cast<float>(uv.y())}, patch, CV_32F);
        patch -= cv::mean(patch)[0];
      };
      take(pair.grey_0, uv0, patch_0);
      take(pair.grey_1, uv1, patch_1);
      take(pair.grey_1, uv0, patch_unmoved);
      off += 1 - patch_0.dot(patch_1) / (cv::norm(patch_0) * cv::norm(patch_1));
      unmoved += 1 - patch_0.dot(patch_unmoved) / (cv::norm(patch_0) * cv::norm(patch_unmoved));
      ++count;
    }
    ASSERT_GT(count, 30);
    EXPECT_LT(off / count, 0.2);
    EXPECT_GT(unmoved / count, 0.5);
  }
  EXPECT_EQ(memory.size(), 20u);
  for (size_t i = 1; i < pairs.size(); ++i)
    EXPECT_GT(cv::norm(pairs[i].grey_0, pairs[0].grey_0, cv::NORM_L1), 3e4) << i;  // at least in noise
}

TEST(Peers, RgbdOdometryGetsAModelOfWhatIsFarAway) {
  PeerPair pair = make_bench_pairs({320, 240, 50}, 1, kQuiet).front();
  const auto method = make_rgbd_odometry();
  const PeerAnswer near = method->run(pair);
  ASSERT_TRUE(near.claimed);
  pair.depth_0 *= 60;  // two metres become a view from the air
  pair.depth_1 *= 60;
  const PeerAnswer far = method->run(pair);
  ASSERT_TRUE(far.claimed);
  EXPECT_GT(near.T_10.t.norm(), 1e-3);
  EXPECT_LT((far.T_10.t / 60 - near.T_10.t).norm(), 0.2 * near.T_10.t.norm());
  EXPECT_LT((far.T_10.R - near.T_10.R).norm(), 2e-3);
}

TEST(Bench, EveryMethodSolvesWhatItIsTimedOn) {
  ICLK_NEED_DEVICE();
  const BenchReport report = run_bench(tiny(), test::device(), kQuiet);
  const nlohmann::ordered_json json = nlohmann::ordered_json::parse(to_json(report).dump());
  EXPECT_FALSE(json.at("machine").at("device").get<std::string>().empty());
  EXPECT_GE(json.at("machine").at("cores").get<int>(), 1);
  EXPECT_GT(json.at("machine").at("cores_got").get<double>(), 0.05);
  EXPECT_LE(json.at("machine").at("cores_got").get<double>(), json.at("machine").at("cores").get<int>() + 0.5);
  std::multiset<std::string> methods;
  for (const auto& row : json.at("rows")) {
    const auto method = row.at("method").get<std::string>();
    methods.insert(method);
    EXPECT_GT(row.at("ms_per_pair").get<double>(), 0) << method;
    EXPECT_GE(row.at("ms_per_pair").get<double>(), row.at("ms_min").get<double>()) << method;
    EXPECT_LE(row.at("ms_per_pair").get<double>(), row.at("ms_max").get<double>()) << method;
    EXPECT_GT(row.at("cpu_ms_per_pair").get<double>(), 0) << method;
    EXPECT_EQ(row.at("converged"), row.at("run")) << method;
    EXPECT_LT(row.at("median_e_pixel").get<double>(), 0.5) << method;
  }
  EXPECT_EQ(methods,
            (std::multiset<std::string>{"RgbdOdometry", "RgbdOdometry, 1 thread", "cpu", "cpu", "device", "device",
                                        "device + refine", "device + refine", "device + search", "device + search",
                                        "device, colour", "device, unit weights", "device, unit weights", "host", "host"}));
  EXPECT_NEAR(json.at("times_faster_than").at("ratio").at("RgbdOdometry").get<double>(),
              bench_wall(report, "RgbdOdometry", 1) / bench_wall(report, "device", 2), 1e-9);
  ASSERT_EQ(json.at("profiles").size(), 2u);
  for (const auto& profile : json.at("profiles")) {
    double sum = 0;
    for (const auto& stage : profile.at("stages")) sum += stage.at("ms_per_pair").get<double>();
    EXPECT_GT(sum, 0);
  }
  const std::string table = to_table(report);
  for (const std::string& method : methods) EXPECT_NE(table.find(method), std::string::npos) << method;
}

TEST(Bench, OnlyWhatWasAskedFor) {
  ICLK_NEED_DEVICE();
  BenchOptions options = tiny();
  options.only = {"cpu"};
  options.profile = false;
  options.pairs = {1};
  const BenchReport report = run_bench(options, test::device(), kQuiet);
  ASSERT_EQ(report.rows.size(), 1u);
  EXPECT_EQ(report.rows[0].method, "cpu");
  EXPECT_EQ(report.rows[0].calls, 16);
  EXPECT_TRUE(to_json(report).at("times_faster_than").at("ratio").at("RgbdOdometry").is_null());
}

}  // namespace
}  // namespace iclk
