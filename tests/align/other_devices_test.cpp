// Other devices, the same answer: with small texel buffers, for which shaders read storage buffers, and with a watchdog, for
// which work is cut into parts.
#include <iclk/refine/refiner.h>

#include "random_model.h"
#include "solvers.h"

namespace iclk::test {
namespace {

struct Setting {
  const char* name;
  PixelFormat format;
  bool learned = false, search = false, masked = false, dense = false;
};

void PrintTo(const Setting& setting, std::ostream* out) { *out << setting.name; }

class OtherDevices : public testing::TestWithParam<Setting> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
  static std::shared_ptr<engine::Context> storage_context() {
    engine::ContextOptions options = watched_options();
    options.storage_reads = true;
    return engine::create_context(options);
  }
  /// The last of `times` runs of one aligner.
  RefinedAlignment run(const std::shared_ptr<engine::Context>& context, Solver solver, int times = 1) const {
    const Setting& setting = GetParam();
    Relief scene = moved_relief();
    const Features features = random_features(scene, 60);
    const Frame image0 = render(scene, 0), image1 = render(scene, 1);
    std::vector<uint8_t> mask(image1.data.size(), 255);
    std::fill_n(mask.begin(), 160 * 40, uint8_t{0});
    Frame inverse_depth = image0;
    for (int v = 0; v < image0.height; ++v)
      for (int u = 0; u < image0.width; ++u) inverse_depth.at(u, v) = static_cast<float>(1 / scene.depth({u, v}));
    std::shared_ptr<const Model> model;
    AlignerOptions options;
    if (setting.learned) {
      model = std::make_shared<const Model>(random_model({{8, 8, 8}, {8, 8, 8}, {8, 8, 8}}));
      options = model->options();
      options.iterations = 4;
    }
    options.search = setting.search;
    Plan plan = plan_for(scene.camera, 60);
    plan.format = setting.format;
    plan.target_masks = setting.masked;
    plan.dense = setting.dense;
    const auto aligner = make_device_aligner(context, plan, options, solver, model);
    Reference reference{image0.view(), scene.camera, features, {}};
    if (setting.dense) reference.inverse_depth = inverse_depth.view();
    aligner->set_reference(0, reference);
    Pair pair{0, image1.view(), {}, {}};
    if (setting.masked) pair.target_mask = {mask.data(), image1.width, image1.height, 0, PixelFormat::r8};
    Refiner refiner(*aligner);
    RefinedAlignment result;
    for (int i = 0; i < times; ++i) result = refiner.align(pair);
    return result;
  }
};

TEST_P(OtherDevices, ThatReadStorageBuffersGiveTheSameAnswer) {
  // requirements() asks for them where texel buffers are small.
  if (device()->limits().maxPerStageDescriptorStorageBuffers < 11) GTEST_SKIP() << "a device that reads texel buffers alone";
  const auto context = storage_context();
  for (const Solver solver : {Solver::host, Solver::device}) {
    const RefinedAlignment a = run(device(), solver), b = run(context, solver);
    EXPECT_EQ(a.iclk.status, b.iclk.status) << a.iclk.reason << " / " << b.iclk.reason;
    EXPECT_LT(distance(a.iclk.T_10, b.iclk.T_10, 4), 1e-5);
    EXPECT_NEAR(a.iclk.visible_fraction, b.iclk.visible_fraction, 1e-3);
    EXPECT_EQ(a.status, b.status) << a.reason << " / " << b.reason;
    EXPECT_LT(distance(a.T_10, b.T_10, 4), 1e-5);
    EXPECT_NEAR(a.aligned, b.aligned, 1);
  }
}

TEST_P(OtherDevices, ThatAreWatchedGiveTheSameBits) {
  engine::ContextOptions options = watched_options();
  options.longest_submission = 0;
  const auto context = engine::create_context(options);
  for (const Solver solver : {Solver::host, Solver::device}) {
    const RefinedAlignment a = run(device(), solver), b = run(context, solver, 4);  // cut smaller each time
    EXPECT_EQ(a.iclk.T_10.matrix(), b.iclk.T_10.matrix());
    EXPECT_EQ(a.iclk.covariance, b.iclk.covariance);
    EXPECT_EQ(a.T_10.matrix(), b.T_10.matrix());
    EXPECT_EQ(a.aligned, b.aligned);
  }
}

INSTANTIATE_TEST_SUITE_P(All, OtherDevices,
                         testing::Values(Setting{"r8", PixelFormat::r8}, Setting{"bgra8", PixelFormat::bgra8, false, true},
                                         Setting{"r32f", PixelFormat::r32f, false, true},
                                         Setting{"masked", PixelFormat::rgba32f, false, true, true},
                                         Setting{"dense", PixelFormat::r8, false, false, false, true},
                                         Setting{"learned_r8", PixelFormat::r8, true},
                                         Setting{"learned_rgba32f", PixelFormat::rgba32f, true, true},
                                         Setting{"learned_rgba8", PixelFormat::rgba8, true}),
                         [](const auto& info) { return info.param.name; });

}  // namespace
}  // namespace iclk::test
