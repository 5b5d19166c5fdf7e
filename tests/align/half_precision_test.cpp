// Activations in half precision: the same network within a stated bound, half of the memory, no device feature.
#include <cmath>

#include <iclk/engine/error.h>

#include "device_encoder.h"
#include "host_application.h"
#include "plain_network.h"
#include "random_model.h"
#include "solvers.h"

namespace iclk::test {
namespace {

AlignerOptions half_options(const Model& model) {
  AlignerOptions options = model.options();
  options.precision = Precision::fp16;
  return options;
}

class HalfEncoder : public testing::TestWithParam<std::tuple<ConvVariant, bool>> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};

TEST_P(HalfEncoder, IsThePlainOneToTwoThousandthsOfTheRange) {
  const auto [variant, shuffle] = GetParam();
  if (shuffle && !internal::can_shuffle(device()->info())) GTEST_SKIP() << "no subgroup shuffles here";
  constexpr int kWidth = 203, kHeight = 127, kLevels = 3;
  const auto model = odd_model();
  DeviceEncoder encoder(model, kWidth, kHeight, kLevels, PixelFormat::rgba8);
  encoder.shuffle = shuffle;
  encoder.precision = Precision::fp16;
  encoder.most_bytes = 400'000;
  ASSERT_GT(encoder.tiling().columns.size() * encoder.tiling().rows.size(), 1u);
  encoder.use(variant);
  std::mt19937 random(6);
  std::vector<std::vector<uint8_t>> images(2);
  for (auto& image : images)
    for (int i = 0; i < 3 * kWidth * kHeight; ++i) image.push_back(static_cast<uint8_t>(random()));
  const auto together = encoder.encode(images, 2), alone = encoder.encode({images[1]}, 1);
  const size_t stride = encoder.layout.map_stride;
  for (size_t i = 0; i < images.size(); ++i) {
    const Pyramid expected = internal::encode(*model, {images[i].data(), kWidth, kHeight, 0, PixelFormat::rgb8}, kLevels);
    for (size_t l = 0; l < expected.size(); ++l) {
      const auto& info = encoder.layout.levels[l];
      const auto [least, most] = std::minmax_element(expected[l].data.begin(), expected[l].data.end());
      double worst = 0;
      for (uint32_t v = 0; v < info.height; ++v)
        for (uint32_t u = 0; u < info.width; ++u) {
          const size_t at = info.map_offset + v * info.pitch + u;
          const float value = together[i * stride + at];
          ASSERT_FALSE(std::isnan(value)) << "level " << l << " at " << u << ", " << v;
          if (i == 1) {
            ASSERT_EQ(value, alone[at]) << "level " << l << " at " << u << ", " << v;
          }
          worst =
              std::max(worst, static_cast<double>(std::abs(value - expected[l].at(static_cast<int>(u), static_cast<int>(v)))));
        }
      const double range = static_cast<double>(*most - *least);
      EXPECT_LT(worst, 2e-3 * range) << "level " << l;
      EXPECT_GT(worst, 1e-5 * range) << "level " << l << ": this is single precision";
    }
  }
}
INSTANTIATE_TEST_SUITE_P(Variants, HalfEncoder,
                         testing::Combine(testing::ValuesIn(kConvVariants),
                                          testing::Bool()),  // cooperative: direct where there are no matrices
                         [](const auto& info) {
                           return name(std::get<0>(info.param)) + std::string(std::get<1>(info.param) ? "" : "_plain");
                         });

TEST(HalfPrecision, HalvesTheMemoryOfActivations) {
  ICLK_NEED_DEVICE();
  const auto model = std::make_shared<Model>(random_model({{16, 32, 32}, {32, 64, 64}}));
  const Plan plan = plan_for({1, 1, 0, 0, 752, 480});
  const auto bytes = [&](Precision precision) {
    AlignerOptions options = model->options();
    options.precision = precision;
    return DeviceAligner::workspace_size(*device(), plan, options, Solver::device, model).total();
  };
  // 32 channels lie in one buffer, 16 and later 64 of half the size in the other. What the last layer of a level gives is
  // not written but by kernels that do not reduce it, all those of a GPU.
  const auto tensors = internal::encoder_tensors(*model, 752, 480, 2);
  const bool written = device()->info().type != engine::DeviceType::cpu || device()->storage_reads();
  const uint64_t last = written ? tensors[0][3].texels() : 0;
  const uint64_t texels = tensors[0][2].texels() + std::max({tensors[0][1].texels(), last, tensors[1][2].texels()});
  const double saved = static_cast<double>(bytes(Precision::fp32) - bytes(Precision::fp16));
  EXPECT_NEAR(saved, static_cast<double>(2 * 8 * texels), 1e4);  // both images of the pair
}

TEST(HalfPrecision, TilesHoldTwiceAsManyPixels) {
  const Model model = random_model({{32, 32}, {32, 32}});
  const auto tiles = [&](Precision precision) {
    const internal::Tiling tiling(model, 1500, 1200, 2, precision);
    return tiling.columns.size() * tiling.rows.size();
  };
  EXPECT_EQ(tiles(Precision::fp32), 2u);
  EXPECT_EQ(tiles(Precision::fp16), 1u);
}

TEST(HalfPrecision, AnAdoptedDeviceNeedsNoFeature) {
  ICLK_NEED_DEVICE();
  const Application app;
  const auto adopted = engine::adopt_device({app.instance.handle(), app.physical, app.device, app.queue, app.family});
  const Relief scene;
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Features features = random_features(scene, 30);
  const std::shared_ptr<const Model> model = odd_model();
  std::vector<Alignment> results;
  for (const auto& context : {adopted, device()}) {
    const auto aligner = make_device_aligner(context, plan_for(scene.camera), half_options(*model), Solver::device, model);
    aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
    results.push_back(aligner->align(Pair{0, image1.view(), {}, {}}));
  }
  EXPECT_TRUE(same_bits(results[0], results[1]));
}

TEST(HalfPrecision, WhatOverflowsEndsInAStatus) {
  ICLK_NEED_DEVICE();
  const Relief scene;
  Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Features features = random_features(scene, 30);
  const std::shared_ptr<const Model> model = odd_model();
  const auto aligner = make_device_aligner(device(), plan_for(scene.camera), half_options(*model), Solver::device, model);
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  for (float& x : image1.data) x = 1e6f * x;  // a half ends at 65504
  const Alignment a = aligner->align(Pair{0, image1.view(), {}, {}});
  EXPECT_FALSE(a.converged());
  EXPECT_TRUE(a.T_10.matrix().allFinite());
}

}  // namespace
}  // namespace iclk::test
