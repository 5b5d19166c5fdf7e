// The result is honest: what cannot be aligned says so, on every solver.
#include <limits>

#include <Eigen/Eigenvalues>

#include "solvers.h"

namespace iclk::test {
namespace {

class Honest : public Solvers {
 protected:
  Relief scene;
  Features features = random_features(scene, 50);

  Alignment align(Aligner& aligner, const Frame& image0, const Frame& image1) const {
    aligner.set_reference(0, {image0.view(), scene.camera, features, {}});
    return aligner.align(Pair{0, image1.view(), {}, {}});
  }
};

Frame constant(const Relief& scene, float value) {
  Frame frame = render(scene, 0);
  std::fill(frame.data.begin(), frame.data.end(), value);
  return frame;
}

bool finite(const Alignment& a) {
  return a.T_10.matrix().allFinite() && a.H.allFinite() && a.covariance.allFinite() && std::isfinite(a.cost);
}

TEST_P(Honest, ConstantImagesAreDegenerate) {
  const Frame textured = render(scene, 0);
  for (bool photometric : {false, true})
    for (Damping damping : {Damping::fixed, Damping::adaptive}) {
      AlignerOptions options;
      options.photometric = photometric;
      options.damping = damping;
      const auto aligner = make_aligner(way(), plan_for(scene.camera), options);
      for (float value : {0.0f, 0.5f, 1.0f}) {
        const Frame flat = constant(scene, value);
        const Alignment both = align(*aligner, flat, flat);
        EXPECT_EQ(both.status, Status::degenerate) << both.reason;
        EXPECT_EQ(both.covariance, Matrix6d::Zero());
        const Alignment reference = align(*aligner, flat, textured);
        EXPECT_EQ(reference.status, Status::degenerate) << reference.reason;
        const Alignment target = align(*aligner, textured, flat);  // a black target among them
        EXPECT_NE(target.status, Status::converged) << value << ": " << target.reason;
        EXPECT_TRUE(finite(target));
      }
    }
}

// The aperture problem. Edges of one direction along an axis leave H exactly singular. In any other direction the unequal
// attenuation of central differences, and noise at any rate, are texture to H, and the pose ends up to 35 px off with a
// correlation of 1.00 and still images: only the agreement of both gradients tells.
TEST_P(Honest, EdgesOfOneDirectionNeverConverge) {
  scene.T_10.t.x() = 0.05;
  AlignerOptions options;
  options.robust = Robust::unit;  // with weights a few of these poses leave the image instead: low_overlap
  const auto aligner = make_aligner(way(), plan_for(scene.camera), options);
  const auto weighted = make_aligner(way(), plan_for(scene.camera));
  for (double direction : {0.0, M_PI / 2, 0.7, -0.3, -0.7, 0.1})
    for (double noise : {0.0, 0.003, 0.01, 0.03}) {
      scene.direction = direction;
      scene.noise = noise;
      const Alignment a = align(*aligner, render(scene, 0), render(scene, 1));
      EXPECT_EQ(a.status, Status::degenerate) << direction << ", " << noise << ": " << a.reason;
      EXPECT_EQ(a.covariance, Matrix6d::Zero());
      EXPECT_LT(a.agreement, 0.08);
      const Status with_weights = align(*weighted, render(scene, 0), render(scene, 1)).status;
      EXPECT_TRUE(with_weights == Status::degenerate || with_weights == Status::low_overlap) << direction << ", " << noise;
    }
}

// A prior that holds what the images do not say makes them enough.
TEST_P(Honest, AFirmPriorNeedsNoTexture) {
  scene.T_10.t.x() = 0.05;
  scene.direction = 0.1;
  scene.noise = 0.01;
  const auto aligner = make_aligner(way(), plan_for(scene.camera));
  aligner->set_reference(0, {render(scene, 0).view(), scene.camera, features, {}});
  PosePrior prior{scene.T_10, 1e8 * Matrix6d::Identity()};
  const Frame image1 = render(scene, 1);
  const Alignment held = aligner->align(Pair{0, image1.view(), {}, prior});
  EXPECT_EQ(held.status, Status::converged) << held.reason;
  EXPECT_LT(pixel_error(scene, features, held.T_10), 0.1);
  // About as certain as the prior, 1e-8; a little less, because the iterations took noise for information.
  const Eigen::SelfAdjointEigenSolver<Matrix6d> sigma2(held.covariance);
  EXPECT_LT(sigma2.eigenvalues()(5), 1.3e-8);
  EXPECT_GT(sigma2.eigenvalues()(5), 0.7e-8);
  prior.information = 1e-3 * Matrix6d::Identity();  // as good as none
  EXPECT_EQ(aligner->align(Pair{0, image1.view(), {}, prior}).status, Status::degenerate);
}

TEST_P(Honest, AnUnrelatedTargetNeverConverges) {
  const Frame image0 = render(scene, 0);
  const auto aligner = make_aligner(way(), plan_for(scene.camera));
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  for (uint32_t seed = 2; seed < 32; ++seed) {
    Relief other = scene;
    other.seed = seed;
    const Frame image1 = render(other, 0);
    const Alignment a = aligner->align(Pair{0, image1.view(), {}, {}});
    EXPECT_NE(a.status, Status::converged) << "seed " << seed << ": " << a.reason;
    EXPECT_FALSE(a.reason.empty());
  }
}

TEST_P(Honest, TooFewFeaturesAreCounted) {
  const Frame image = render(scene, 0);
  for (int n : {0, 1, 5}) {
    const Features few = random_features(scene, n);
    const auto aligner = make_aligner(way(), plan_for(scene.camera));
    EXPECT_EQ(aligner->set_reference(0, {image.view(), scene.camera, few, {}}).size(), static_cast<size_t>(n));
    SE3 start;
    start.t.x() = 0.25;
    const Alignment a = aligner->align(Pair{0, image.view(), start, {}});
    EXPECT_EQ(a.status, Status::too_few_features);
    EXPECT_NE(a.reason.find(std::to_string(n) + " of " + std::to_string(n)), std::string::npos) << a.reason;
    EXPECT_NE(a.reason.find("at least 6 needed"), std::string::npos) << a.reason;
    EXPECT_EQ(a.T_10.t, start.t);
    EXPECT_EQ(a.features.size(), static_cast<size_t>(n));
  }
  // In a batch the others go on.
  Plan plan = plan_for(scene.camera);
  plan.max_references = plan.max_pairs = 2;
  const auto aligner = make_aligner(way(), plan);
  aligner->set_reference(0, {image.view(), scene.camera, random_features(scene, 3), {}});
  aligner->set_reference(1, {image.view(), scene.camera, features, {}});
  const auto both = aligner->align(std::vector<Pair>{{0, image.view(), {}, {}}, {1, image.view(), {}, {}}});
  EXPECT_EQ(both[0].status, Status::too_few_features);
  EXPECT_EQ(both[1].status, Status::converged) << both[1].reason;
}

// NaN or infinite pixels of a float image: where a patch meets them nothing can be said, and the status is no success; where
// none does, nothing happens.
TEST_P(Honest, PixelsThatAreNotFiniteNeverEndInAPose) {
  scene.T_10.t.x() = 0.05;
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  constexpr float inf = std::numeric_limits<float>::infinity();
  for (Robust robust : {Robust::unit, Robust::huber}) {
    AlignerOptions options;
    options.robust = robust;
    const auto aligner = make_aligner(way(), plan_for(scene.camera), options);
    for (float bad : {std::numeric_limits<float>::quiet_NaN(), inf, -inf, 3e38f}) {
      const int u = static_cast<int>(features.uv[0].x()), v = static_cast<int>(features.uv[0].y());
      const auto spoil = [&](Frame frame, bool everything) {
        if (everything)
          std::fill(frame.data.begin(), frame.data.end(), bad);
        else
          frame.at(u, v) = bad;
        return frame;
      };
      for (bool everything : {false, true}) {
        SCOPED_TRACE(std::to_string(bad) + (everything ? " everywhere" : " in one pixel"));
        for (const Alignment& a :
             {align(*aligner, spoil(image0, everything), image1), align(*aligner, image0, spoil(image1, everything))}) {
          if (everything) {
            EXPECT_FALSE(a.converged()) << a.reason;
          }
          EXPECT_TRUE(!a.converged() || (finite(a) && pixel_error(scene, features, a.T_10) < 0.5)) << a.reason;
          EXPECT_FALSE(a.reason.empty());
        }
      }
    }
  }
}

// Targets far outside the basin: never converged where the pose is more than 3 px off.
TEST_P(Honest, FarTargetsAreFoundOrRefused) {
  const int shifts = way() == Way::cpu ? 300 : 60;
  const Frame image0 = render(scene, 0);
  const auto aligner = make_aligner(way(), plan_for(scene.camera));
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  std::mt19937 random(17);
  std::normal_distribution<double> normal(0, 1);
  int converged = 0, wrong = 0;
  for (int i = 0; i < shifts; ++i) {
    const double size = 0.2 * (i % 30) / 30;  // up to about 40 px
    Vector6d xi;
    for (int k = 0; k < 6; ++k) xi(k) = size * normal(random) * (k < 3 ? 1.0 : 0.7);
    scene.T_10 = SE3::exp(xi);
    const Frame image1 = render(scene, 1);
    const Alignment a = aligner->align(Pair{0, image1.view(), {}, {}});
    if (!a.converged()) continue;
    ++converged;
    const double error = pixel_error(scene, features, a.T_10);
    if (error > 3) {
      ++wrong;
      ADD_FAILURE() << "start " << pixel_error(scene, features, {}) << " px off, end " << error << " px off: " << a.reason;
    }
  }
  std::printf("  %d shifts, %d converged, %d of them wrong\n", shifts, converged, wrong);
  RecordProperty("false_confidences", wrong);
  EXPECT_GT(converged, shifts / 10);
  EXPECT_EQ(wrong, 0);
}

INSTANTIATE_TEST_SUITE_P(All, Honest, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

}  // namespace
}  // namespace iclk::test
