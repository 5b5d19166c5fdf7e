// Depths of another scene, mirrored or constant, fit no pose: that is said.
#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/plane.h>

#include "../support/relief.h"

namespace iclk {
namespace {

using test::Relief;

RefinedAlignment align(const Relief& relief, const Features& features) {
  AlignerOptions options;
  options.search = true;
  Plan plan{relief.camera.width, relief.camera.height};
  plan.max_features = features.size();
  plan.format = PixelFormat::r32f;
  Cascade cascade({{"classical", [&] { return make_cpu_aligner(plan, options); }, RefinerOptions()}});
  const test::Frame image0 = test::render(relief, 0, 1), image1 = test::render(relief, 1, 2);
  const CascadePair pair{{image0.view(), relief.camera, features, {}}, image1.view(), {}};
  return cascade.align(std::span(&pair, 1)).front();
}

Relief seen_sideways() {
  Relief relief;
  relief.T_10 = SE3::exp((Vector6d() << 0.3, 0.1, 0.05, 0.002, -0.003, 0.004).finished());
  relief.noise = 0.004;
  return relief;
}

TEST(LyingDepths, DepthsThatExplainNoMoreThanAPlaneAreNotBelieved) {
  const Relief relief = seen_sideways();
  const Features told = test::random_features(relief, 200);
  Features constant = told, mirrored = told;
  for (size_t i = 0; i < told.uv.size(); ++i) {
    constant.inverse_depth[i] = 1 / relief.distance;
    const Eigen::Vector2d size(relief.camera.width - 1, relief.camera.height - 1);
    mirrored.inverse_depth[i] = 1 / relief.depth(size - told.uv[i]);
  }
  EXPECT_TRUE(align(relief, told).converged());
  for (const Features& features : {constant, mirrored}) {
    const RefinedAlignment r = align(relief, features);
    EXPECT_EQ(r.status, Status::diverged) << r.reason;
    EXPECT_NE(r.reason.find("the depths do not fit the images"), std::string::npos) << r.reason;
    EXPECT_TRUE(r.covariance.isZero(0));
  }
}

TEST(LyingDepths, OnePlaneExplainsAPlaneAndNoRelief) {
  Relief relief = seen_sideways();
  for (const double amplitude : {0.0, 0.25}) {
    relief.depth_amplitude = amplitude;
    const Features features = test::random_features(relief, 200);
    std::vector<AlignedFeature> aligned(features.uv.size());
    for (size_t i = 0; i < aligned.size(); ++i) {
      aligned[i].uv1 = relief.truth(features.uv[i]);
      aligned[i].status = i < 20 ? FeatureStatus::bad_match : FeatureStatus::aligned;
    }
    const int flat = internal::plane_inliers(features, aligned, 0.5);
    if (amplitude > 0) {
      EXPECT_LT(flat, 140);
    } else {
      EXPECT_EQ(flat, 180);
    }
  }
}

}  // namespace
}  // namespace iclk
