// What the JSON and the table say of a covariance that was not computed, and of what refinement knows of each feature.
#include "apps/iclk/session/report.h"

#include <gtest/gtest.h>

#include "apps/iclk/sets/scene.h"

namespace iclk {
namespace {

class Report : public ::testing::Test {
 protected:
  Report() {
    const ScenePair scene = make_scene_pair(SE3(), {.width = 160, .height = 120});
    pair_.image_0 = scene.image_0, pair_.image_1 = scene.image_1;
    pair_.camera = scene.camera;
    pair_.features.uv = {{80, 60}, {90, 60}, {100, 60}};
    pair_.features.inverse_depth = {0.5, 0.5, 0};
    result_.status = Status::converged;
    result_.covariance = Matrix6d::Identity();
    result_.features.resize(3);
    result_.features[0].status = FeatureStatus::aligned;
    result_.features[0].uv1 = {80, 60};
    result_.features[0].covariance << 0.04, 0.01, 0.01, 0.09;
  }
  nlohmann::ordered_json json() const { return to_json(pair_, result_, session_); }

  PairInput pair_;
  RefinedAlignment result_;
  Session session_{{.solver = Solver::cpu, .stages = {{}}}};
};

TEST_F(Report, NoCovarianceIsNotZero) {
  for (const Status status : {Status::converged, Status::max_iterations}) {
    result_.status = status;
    result_.covariance = 4 * Matrix6d::Identity();
    EXPECT_EQ(json()["covariance"][0][0], 4.0);
    EXPECT_NE(to_table(pair_, result_, session_).find("1 sigma"), std::string::npos);
    result_.covariance.setZero();  // a refinement whose iterations were used up leaves it so
    const auto covariance = json()["covariance"];
    ASSERT_EQ(covariance.size(), 6u);
    for (const auto& row : covariance)
      for (const auto& value : row) EXPECT_TRUE(value.is_null());
    EXPECT_EQ(to_table(pair_, result_, session_).find("1 sigma"), std::string::npos);
  }
}

TEST_F(Report, FeaturesHaveTheirCovarianceWhereTheyWereAligned) {
  const auto features = json()["features"];
  EXPECT_EQ(features[0]["covariance"].dump(), "[[0.04,0.01],[0.01,0.09]]");
  EXPECT_EQ(features[1]["covariance"].dump(), "[[null,null],[null,null]]");
  EXPECT_FALSE(features[0].contains("inverse_depth_sigma"));
  result_.features.clear();
  EXPECT_FALSE(json()["features"][0].contains("covariance")) << "without refinement there is none";
}

TEST_F(Report, RefinedDepthsHaveTheirSigma) {
  result_.inverse_depth = {0.51, 0.5, 0};
  result_.inverse_depth_sigma = {0.002, 0.01, 0};
  const auto features = json()["features"];
  EXPECT_EQ(features[0]["inverse_depth"], 0.51);
  EXPECT_EQ(features[0]["inverse_depth_sigma"], 0.002);
  EXPECT_TRUE(features[2]["inverse_depth_sigma"].is_null()) << "no depth";
}

TEST_F(Report, SaysOnWhatItWasMade) {
  result_.iclk.gain = 1.25, result_.iclk.bias = -0.125;
  const auto r = json();
  EXPECT_EQ(r["schema"], "iclk-result-1");
  EXPECT_TRUE(r["version"].get<std::string>().starts_with("iclk ")) << r["version"];
  EXPECT_EQ(r["gain"], 1.25);
  EXPECT_EQ(r["bias"], -0.125);
  EXPECT_EQ(r["camera"]["fx"], pair_.camera.fx);
  EXPECT_EQ(r["camera"]["width"], 160);
}

}  // namespace
}  // namespace iclk
