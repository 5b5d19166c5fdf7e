// What is said of a sensor's depths reaches the covariance.
#include <cmath>

#include <nlohmann/json.hpp>

#include <iclk/session/depth_sigma.h>

#include "apps/iclk/commands/command.h"
#include "command_fixture.h"

namespace iclk {
namespace {

using test::Command;
using test::expect_error;

TEST(DepthSigma, OfSensors) {
  const Camera camera{500, 510, 320, 240, 640, 480};
  const auto sigmas = [&](const std::string& text) {
    Features f;
    f.uv.assign(3, {10, 10});
    f.inverse_depth = {1, 0.5, 0.1};
    f.inverse_depth_sigma = {0, 0.2, std::nan("")};
    parse_depth_sigma(text).apply(camera, f);
    return f.inverse_depth_sigma;
  };
  EXPECT_EQ(sigmas("2%"), (std::vector<double>{0.02, 0.2, 0.002})) << "a feature's own counts";
  EXPECT_EQ(sigmas("structured-light")[2], 0.0014);
  EXPECT_DOUBLE_EQ(sigmas("stereo:0.25,0.1")[0], 0.25 / (500 * 0.1)) << "q = d / (f b)";
  Features mirrored;
  mirrored.uv.assign(1, {10, 10});
  mirrored.inverse_depth = {1};
  parse_depth_sigma("stereo:0.25,0.1").apply({-500, 510, 320, 240, 640, 480}, mirrored);
  EXPECT_DOUBLE_EQ(mirrored.inverse_depth_sigma[0], sigmas("stereo:0.25,0.1")[0]) << "of a camera with fx < 0";
  EXPECT_LT(sigmas("rendered")[0], 1e-5);
  EXPECT_GT(sigmas("rendered")[0], 0);
  Features f;
  f.uv.assign(2, {10, 10});
  f.inverse_depth = {1, 0.5};
  parse_depth_sigma("auto").apply(camera, f);
  EXPECT_TRUE(f.inverse_depth_sigma.empty());
  for (const char* bad :
       {"", "%", "0%", "-1%", "nan%", "1", "stereo", "stereo:", "stereo:1", "stereo:1,0", "stereo:1,2,3", "kinect"})
    expect_error([&] { parse_depth_sigma(bad); }, ErrorCode::invalid_argument, {"--depth-sigma", bad, "structured-light"});
}

TEST_F(Command, DepthSigmaIsInTheCovariance) {
  const auto translation = [](const std::string& sigma) {
    const test::Finished f = test::run(align({"--json", "--depth-sigma", sigma}));
    EXPECT_EQ(f.code, kConverged) << f.err;
    return nlohmann::json::parse(f.out)["covariance"][0][0].get<double>();
  };
  EXPECT_GT(translation("20%"), 3 * translation("rendered"));
  EXPECT_NE(test::run(align({"--depth-sigma", "20"})).err.find("--depth-sigma"), std::string::npos);
}

}  // namespace
}  // namespace iclk
