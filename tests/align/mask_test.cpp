// The mask of the device against the CPU reference, bit by bit, where features crowd: there a pixel lies in hundreds of
// patches, and work that grows with their number squared would take minutes.
#include <iclk/align/device/parts.h>
#include <iclk/align/device/stages.h>
#include <iclk/align/solver/mask.h>

#include "read_back.h"
#include "solvers.h"

namespace iclk::test {
namespace {

/// Elements whose inverse depth in the template is not the mask of the CPU reference.
size_t wrong_elements(const Camera& camera, const Features& features, const AlignerOptions& options, int max_features) {
  const Plan plan = plan_for(camera, max_features);
  DeviceAligner aligner(device(), plan, options, Solver::device);
  Frame frame{camera.width, camera.height, std::vector<float>(static_cast<size_t>(camera.width) * camera.height, 0.5f)};
  for (size_t i = 0; i < frame.data.size(); ++i) frame.data[i] += 0.001f * static_cast<float>(i % 97);
  // Set before by features of other patches: nothing of theirs may stay.
  Features before = features;
  for (Eigen::Vector2d& uv : before.uv) uv = {camera.width - 1 - uv.x(), camera.height - 1 - uv.y()};
  aligner.set_reference(0, {frame.view(), camera, before, {}});
  (void)aligner.align(Pair{0, frame.view(), {}, {}});
  const auto checks = aligner.set_reference(0, {frame.view(), camera, features, {}});
  (void)aligner.align(Pair{0, frame.view(), {}, {}});

  const std::vector<float> a = read_back(internal::DeviceParts::template_pixels(aligner));
  const internal::Layout layout(plan, options);
  size_t wrong = 0;
  for (int level = 0; level < options.levels; ++level) {
    const auto& info = layout.levels[static_cast<size_t>(level)];
    std::vector<float> expected = internal::sparse_mask(features, checks, camera, level);
    expected.resize(info.element_count);  // features that the plan has room for and the reference does not have
    for (uint32_t k = 0; k < info.element_count; ++k) wrong += a[4 * (info.element_offset + k) + 2] != expected[k];
  }
  return wrong;
}

const Camera kCamera{260, 260, 159.5, 119.5, 320, 240};

/// Inverse depths that name their feature.
void name_each(Features& features) {
  features.inverse_depth.clear();
  for (size_t i = 0; i < features.uv.size(); ++i) features.inverse_depth.push_back(0.1 + 1e-4 * static_cast<double>(i));
}

TEST(Mask, OfTenThousandFeaturesIsTheReferences) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.camera = kCamera;
  Features scattered = random_features(scene, 10000, 1, 0);  // also where no patch fits
  Features rows, crowd, one_place;
  for (int i = 0; i < 10000; ++i) {
    rows.uv.emplace_back(4 + 3 * (i % 100), 4 + 2 * (i / 100));  // whole pixels: ties everywhere
    crowd.uv.push_back(Eigen::Vector2d(150, 110) + 0.05 * (scattered.uv[static_cast<size_t>(i)] - Eigen::Vector2d(160, 120)));
    one_place.uv.emplace_back(201.5, 77.25);
  }
  const std::pair<const char*, Features*> cases[] = {
      {"scattered", &scattered}, {"rows", &rows}, {"crowd", &crowd}, {"one place", &one_place}};
  for (const auto& [name, features] : cases) {
    name_each(*features);
    for (size_t i = 3; i < features->uv.size(); i += 7) features->inverse_depth[i] = i % 2 ? 0 : -1;  // take no part
    EXPECT_EQ(wrong_elements(kCamera, *features, {}, 10000), 0u) << name;
  }
}

// Odd sizes, levels beyond the fused ones, borders, and a plan for more features than there are.
TEST(Mask, OfAnySizeIsTheReferences) {
  ICLK_NEED_DEVICE();
  for (const auto& [width, height, levels] : {std::array{203, 151, 4}, {64, 96, 1}, {517, 398, 7}, {33, 40, 2}}) {
    Relief scene;
    scene.camera = {100, 100, 0.5 * width, 0.5 * height, width, height};
    AlignerOptions options;
    options.levels = levels;
    for (int n : {1, 7, 300}) {
      Features features = random_features(scene, n, static_cast<uint32_t>(n), 3);
      const double last_u = width - 5, last_v = height - 5;  // the outermost places of a patch
      const Eigen::Vector2d corners[] = {
          {3, 3}, {last_u, 3}, {3, last_v}, {last_u, last_v}, {last_u + 0.999999, last_v + 0.999999}};
      features.uv.insert(features.uv.end(), std::begin(corners), std::end(corners));
      name_each(features);
      EXPECT_EQ(wrong_elements(scene.camera, features, options, 400), 0u) << width << "x" << height << ", " << n << " features";
    }
  }
}

// More features in one place than lavapipe lets a loop have rounds, over two passes.
TEST(Mask, OfACrowdBeyondTheRoundsOfALoop) {
  ICLK_NEED_DEVICE();
  const Camera camera{60, 60, 31.5, 23.5, 64, 48};
  AlignerOptions options;
  options.levels = 1;
  options.iterations = 1;
  Features features;
  for (int i = 0; i < 40000; ++i) features.uv.emplace_back(20.0 + 1e-5 * (40000 - i), 20.5);  // the last is the nearest to some
  name_each(features);
  EXPECT_EQ(wrong_elements(camera, features, options, 40000), 0u);
}

// The mask reaches the pose: ten thousand features give the reference's.
TEST(Mask, TenThousandFeaturesGiveTheReferencesPose) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.camera = kCamera;
  scene.T_10.t = {0.05, -0.03, 0.06};
  const Features features = random_features(scene, 10000);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Alignment expected = align_once(Way::cpu, scene, image0, image1, features);
  EXPECT_TRUE(expected.converged()) << expected.reason;
  EXPECT_LT(pixel_error(scene, features, expected.T_10), 0.05);
  for (Way way : {Way::host, Way::device}) {
    const Alignment a = align_once(way, scene, image0, image1, features);
    EXPECT_TRUE(a.converged()) << name(way) << ": " << a.reason;
    EXPECT_LT(distance(a.T_10, expected.T_10, scene.distance), 1e-5) << name(way);
    EXPECT_LT((a.H - expected.H).norm(), 1e-3 * expected.H.norm()) << name(way);
    EXPECT_EQ(count_ok(a.features), count_ok(expected.features));
  }
}

}  // namespace
}  // namespace iclk::test
