// Bad input: a typed error that names the value, on every solver; what is merely unusable is left out and said.
#include <functional>
#include <limits>

#include <iclk/engine/error.h>

#include "solvers.h"

namespace iclk::test {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN(), kInf = std::numeric_limits<double>::infinity();

template <class Call>
std::string refusal(Call&& call, ErrorCode code = ErrorCode::invalid_argument) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(static_cast<int>(error.code()), static_cast<int>(code)) << error.what();
    return error.what();
  }
  return "accepted";
}

#define EXPECT_SAYS(message, part)                                                               \
  do {                                                                                           \
    const std::string said = message;                                                            \
    EXPECT_NE(said.find(part), std::string::npos) << "expected: " << part << "\nsaid: " << said; \
  } while (false)

TEST(Options, EachValueHasItsRange) {
  const auto with = [](auto change) {
    AlignerOptions options;
    change(options);
    return refusal([&] { options.check(); });
  };
  EXPECT_EQ(with([](AlignerOptions&) {}), "accepted");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.levels = 0; }), "levels is 0");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.levels = 13; }), "1 to 12");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.iterations = 0; }), "iterations is 0");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.iterations = 101; }), "1 to 100");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.lambda = -1; }), "lambda is -1");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.lambda = kNaN; }), "lambda is nan");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.step_tolerance = -0.1; }), "step_tolerance is -0.1");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.step_tolerance = kInf; }), "step_tolerance is inf");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.min_features = 2; }), "min_features is 2");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.min_visible = 1.5; }), "min_visible is 1.5");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.min_visible = kNaN; }), "min_visible is nan");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.min_correlation = -1.5; }), "min_correlation is -1.5");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.carry = 1.5; }), "carry is 1.5");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.residual_sigma = 0; }), "residual_sigma is 0");
  EXPECT_SAYS(with([](AlignerOptions& o) { o.min_agreement = 2; }), "min_agreement is 2");
}

TEST(PlanCheck, EachValueHasItsRange) {
  const auto with = [](auto change) {
    Plan plan{640, 480};
    AlignerOptions options;
    change(plan, options);
    return refusal([&] { plan.check(options); });
  };
  EXPECT_EQ(with([](Plan&, AlignerOptions&) {}), "accepted");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.width = 0; }), "image width is 0");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.height = -5; }), "image height is -5");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.width = 32769; }), "at most 32768");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.max_features = 0; }), "max_features is 0");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.max_features = 65536; }), "65535");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.max_references = 0; }), "max_references is 0");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.max_pairs = 0; }), "max_pairs is 0");
  EXPECT_SAYS(with([](Plan& p, AlignerOptions& o) { p.dense = o.search = true; }), "sparse");
  // 16x16 pixels are too few for 4 levels; the message says what to do.
  EXPECT_SAYS(with([](Plan& p, AlignerOptions&) { p.width = p.height = 16; }), "at least 24 for 4 levels (use fewer levels");
  EXPECT_EQ(with([](Plan& p, AlignerOptions& o) { p.width = p.height = 16, o.levels = 1; }), "accepted");
}

class Input : public Solvers {
 protected:
  Input() {
    image = render(scene, 0);
    features = random_features(scene, 20);
    plan = plan_for(scene.camera);
    plan.max_references = 2;
  }
  Relief scene;
  Frame image;
  Features features;
  Plan plan;
};

TEST_P(Input, EveryErrorNamesItsValue) {
  const auto aligner = make_aligner(way(), plan);
  const auto reference = [&](auto change, int slot = 0) {
    Reference r{image.view(), scene.camera, features, {}};
    change(r);
    return refusal([&] { aligner->set_reference(slot, r); });
  };
  EXPECT_SAYS(refusal([&] { aligner->align(Pair{1, image.view(), {}, {}}); }), "pair 0: reference slot 1 was never set");
  EXPECT_EQ(reference([](Reference&) {}), "accepted");
  EXPECT_SAYS(reference([](Reference&) {}, -1), "slot -1 is outside the range of the plan, 0 to 1");
  EXPECT_SAYS(reference([](Reference&) {}, 2), "slot 2 is outside the range of the plan, 0 to 1");
  EXPECT_SAYS(reference([](Reference& r) { r.image = {}; }), "reference image is empty (0x0)");
  EXPECT_SAYS(reference([](Reference& r) { r.image.data = nullptr; }), "empty");
  EXPECT_SAYS(reference([](Reference& r) { r.image.width = 80; }),
              "reference image is 80x120, but the plan was made for 160x120");
  EXPECT_SAYS(reference([](Reference& r) { r.image.height = -120; }), "160x-120");
  EXPECT_SAYS(reference([](Reference& r) { r.image.row_stride = 639; }), "row stride of 639 bytes");
  EXPECT_SAYS(reference([](Reference& r) { r.camera.fx = 0; }), "focal length");
  EXPECT_SAYS(reference([](Reference& r) { r.camera.cy = kNaN; }), "nan");
  EXPECT_SAYS(reference([](Reference& r) { r.camera.width = 320; }),
              "camera is for 320x120 images, but the reference image is 160x120");
  EXPECT_SAYS(reference([&](Reference& r) { r.features = random_features(scene, way() == Way::split ? 601 : 51); }),
              "features, but the plan has room for");
  EXPECT_SAYS(reference([](Reference& r) { r.features.inverse_depth.pop_back(); }), "20 feature pixels but 19 inverse depths");
  EXPECT_SAYS(reference([](Reference& r) { r.features.inverse_depth_sigma = {0.1}; }),
              "20 feature pixels but 1 inverse depth sigmas");

  const auto pair = [&](auto change) {
    Pair p{0, image.view(), {}, {}};
    change(p);
    return refusal([&] { aligner->align(std::vector<Pair>{{0, image.view(), {}, {}}, p}); });
  };
  EXPECT_EQ(pair([](Pair&) {}), "accepted");
  EXPECT_SAYS(pair([](Pair& p) { p.reference = 1; }), "pair 1: reference slot 1 was never set");
  EXPECT_SAYS(pair([](Pair& p) { p.reference = 7; }), "slot 7");
  EXPECT_SAYS(pair([](Pair& p) { p.target = {}; }), "pair 1: target image is empty");
  EXPECT_SAYS(pair([](Pair& p) { p.target.height = 121; }), "pair 1: target image is 160x121");
  EXPECT_SAYS(pair([](Pair& p) { p.target.row_stride = 1; }), "row stride of 1 bytes");
  EXPECT_SAYS(pair([](Pair& p) { p.T_10.t.z() = kInf; }), "pair 1: initial pose is not finite");
  EXPECT_SAYS(pair([](Pair& p) { p.T_10.R.setZero(); }), "determinant");
  const auto prior = [&](auto change) {
    return pair([&](Pair& p) {
      p.prior = PosePrior{};
      p.prior->information.setIdentity();
      change(*p.prior);
    });
  };
  EXPECT_EQ(prior([](PosePrior&) {}), "accepted");
  EXPECT_SAYS(prior([](PosePrior& q) { q.T_10.t.x() = kNaN; }), "prior is not finite");
  EXPECT_SAYS(prior([](PosePrior& q) { q.information(2, 3) = kInf; }), "prior is not finite");
  EXPECT_SAYS(prior([](PosePrior& q) { q.information(2, 3) = 1; }), "not symmetric");
  EXPECT_SAYS(prior([](PosePrior& q) { q.information(2, 2) = -1; }), "not symmetric and positive semidefinite");

  // After all that the aligner is as good as new.
  const Alignment a = aligner->align(Pair{0, image.view(), {}, {}});
  EXPECT_TRUE(a.converged()) << a.reason;
  EXPECT_LT(distance(a.T_10, {}, 1), 1e-5);
}

TEST_P(Input, UnusableFeaturesAreLeftOutOneByOne) {
  scene.T_10.t.x() = 0.05;
  const Frame target = render(scene, 1);
  Features good = features, all = features;
  struct Bad {
    Eigen::Vector2d uv;
    double q;
    FeatureCheck check;
  };
  const double q = 0.25;
  const std::vector<Bad> bad = {
      {{kNaN, 50}, q, FeatureCheck::not_finite},     {{50, kInf}, q, FeatureCheck::not_finite},
      {{50, 50}, kNaN, FeatureCheck::not_finite},    {{50, 50}, kInf, FeatureCheck::not_finite},
      {{50, 50}, -kInf, FeatureCheck::not_finite},   {{50, 50}, 0, FeatureCheck::no_depth},
      {{50, 50}, -0.25, FeatureCheck::no_depth},     {{-5, 50}, q, FeatureCheck::outside_image},
      {{1e300, 50}, q, FeatureCheck::outside_image}, {{50, -1e300}, q, FeatureCheck::outside_image},
      {{2.99, 50}, q, FeatureCheck::outside_image},  {{50, 2.99}, q, FeatureCheck::outside_image},
      {{156, 50}, q, FeatureCheck::outside_image},   {{50, 116}, q, FeatureCheck::outside_image},
  };
  for (const Bad& b : bad) {
    all.uv.push_back(b.uv);
    all.inverse_depth.push_back(b.q);
  }
  for (const Eigen::Vector2d& uv :
       {Eigen::Vector2d(3, 3), Eigen::Vector2d(155.99, 115.99)})  // the last places with a whole patch
    for (Features* f : {&all, &good}) {
      f->uv.push_back(uv);
      f->inverse_depth.push_back(1 / scene.depth(uv));
    }
  const auto aligner = make_aligner(way(), plan);
  const auto checks = aligner->set_reference(0, {image.view(), scene.camera, all, {}});
  ASSERT_EQ(checks.size(), all.uv.size());
  for (size_t i = 0; i < 20; ++i) EXPECT_EQ(checks[i], FeatureCheck::ok);
  for (size_t i = 0; i < bad.size(); ++i) EXPECT_STREQ(name(checks[20 + i]), name(bad[i].check)) << "bad feature " << i;
  EXPECT_EQ(checks[checks.size() - 2], FeatureCheck::ok);
  EXPECT_EQ(checks.back(), FeatureCheck::ok);
  EXPECT_EQ(summary(checks), "22 of 36 features usable (5 not_finite, 2 no_depth, 7 outside_image)");
  EXPECT_EQ(aligner->checks(0), checks);

  const Alignment with = aligner->align(Pair{0, target.view(), {}, {}});
  EXPECT_EQ(with.features, checks);
  EXPECT_TRUE(with.converged()) << with.reason;
  aligner->set_reference(0, {image.view(), scene.camera, good, {}});
  const Alignment without = aligner->align(Pair{0, target.view(), {}, {}});
  EXPECT_LT(distance(with.T_10, without.T_10, scene.distance), 1e-6);
  EXPECT_LT(pixel_error(scene, features, with.T_10), 0.05);

  // None is left.
  Features none = all;
  none.uv.assign(all.uv.begin() + 20, all.uv.begin() + 34);
  none.inverse_depth.assign(all.inverse_depth.begin() + 20, all.inverse_depth.begin() + 34);
  aligner->set_reference(0, {image.view(), scene.camera, none, {}});
  const Alignment a = aligner->align(Pair{0, target.view(), {}, {}});
  EXPECT_EQ(a.status, Status::too_few_features);
  EXPECT_SAYS(a.reason, "0 of 14 features usable (5 not_finite, 2 no_depth, 7 outside_image)");
}

// Extreme but finite depths must not upset the others.
TEST_P(Input, AbsurdDepthsDoNotCrash) {
  for (double q : {1e-300, 1e-30, 1e30, 1e300}) {
    Features absurd = features;
    absurd.inverse_depth[3] = q;
    const auto aligner = make_aligner(way(), plan);
    aligner->set_reference(0, {image.view(), scene.camera, absurd, {}});
    const Alignment a = aligner->align(Pair{0, image.view(), {}, {}});
    EXPECT_FALSE(a.reason.empty());
    EXPECT_TRUE(!a.converged() || distance(a.T_10, {}, scene.distance) < 1e-3) << q << ": " << a.reason;
  }
}

TEST_P(Input, SmallImagesWithOneLevel) {
  scene.camera = {14, 14, 7.5, 7.5, 16, 16};
  scene.longest = 14;
  const Frame small = render(scene, 0);
  Features few;
  for (int i = 0; i < 8; ++i) {
    few.uv.emplace_back(3.5 + i, 11.2 - i);
    few.inverse_depth.push_back(1 / scene.depth(few.uv.back()));
  }
  AlignerOptions options;
  options.levels = 1;
  const Alignment a = align_once(way(), scene, small, small, few, options);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_LT(distance(a.T_10, {}, scene.distance), 1e-5);
  EXPECT_SAYS(refusal([&] { make_aligner(way(), plan_for(scene.camera)); }), "use fewer levels");
}

TEST_P(Input, AnyRowStride) {
  scene.T_10.t.x() = 0.05;
  const Frame target = render(scene, 1);
  const Alignment expected = align_once(way(), scene, image, target, features);
  const size_t stride = 160 * 4 + 7;  // not even a multiple of a float
  std::vector<uint8_t> padded0(stride * 120, 0xee), padded1 = padded0;
  for (size_t v = 0; v < 120; ++v) {
    std::memcpy(&padded0[v * stride], &image.data[v * 160], 160 * 4);
    std::memcpy(&padded1[v * stride], &target.data[v * 160], 160 * 4);
  }
  const auto aligner = make_aligner(way(), plan_for(scene.camera, features.size()));
  aligner->set_reference(0, {{padded0.data(), 160, 120, stride, PixelFormat::r32f}, scene.camera, features, {}});
  EXPECT_TRUE(same_bits(aligner->align(Pair{0, {padded1.data(), 160, 120, stride, PixelFormat::r32f}, {}, {}}), expected));
}

INSTANTIATE_TEST_SUITE_P(All, Input, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

class TenThousand : public Solvers {};

// Few levels and iterations for the sake of the suite's time; mask_test.cpp has the default ones.
TEST_P(TenThousand, Features) {
  Relief scene;
  scene.camera = {520, 520, 319.5, 239.5, 640, 480};
  scene.T_10.t.x() = 0.01;
  const Features many = random_features(scene, 10000);
  AlignerOptions options;
  options.robust = Robust::tukey;
  options.iterations = 4;
  options.levels = 1;
  const Alignment a = align_once(way(), scene, render(scene, 0), render(scene, 1), many, options);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_LT(pixel_error(scene, many, a.T_10), 0.05);
  EXPECT_EQ(count_ok(a.features), 10000);
}

INSTANTIATE_TEST_SUITE_P(All, TenThousand, testing::Values(Way::cpu, Way::host, Way::device), way_name);

/// Pixels of a coloured image in a format; red, green and blue are different mixtures, so that an exchange is seen.
std::vector<uint8_t> encode(const Frame& frame, PixelFormat format) {
  std::vector<uint8_t> out;
  const int n = channels(format);
  const size_t size = bytes_per_pixel(format) / static_cast<size_t>(n);
  const bool bgr = format == PixelFormat::bgr8 || format == PixelFormat::bgra8 || format == PixelFormat::bgr16;
  for (size_t i = 0; i < frame.data.size(); ++i) {
    const float grey = std::clamp(frame.data[i], 0.0f, 1.0f),
                other = std::clamp(frame.data[(i + 37) % frame.data.size()], 0.0f, 1.0f);
    const float rgba[4] = {grey, 0.5f * (grey + other), other, 1.0f};
    for (int c = 0; c < n; ++c) {
      const float value = n == 1 ? grey : rgba[bgr && c < 3 ? 2 - c : c];
      uint8_t bytes[4];
      if (size == 1) {
        bytes[0] = static_cast<uint8_t>(std::lround(255 * value));
      } else if (size == 2) {
        const auto wide = static_cast<uint16_t>(std::lround(65535 * value));
        std::memcpy(bytes, &wide, 2);
      } else {
        std::memcpy(bytes, &value, 4);
      }
      out.insert(out.end(), bytes, bytes + size);
    }
  }
  return out;
}

// Every format of the host through every format of the device, against the CPU reference on the same pixels.
TEST(Formats, EveryHostFormatThroughEveryDeviceFormat) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.camera = {105, 105, 64.5, 49.5, 130, 100};  // rows of no round size
  scene.T_10.t = {0.06, -0.04, 0.1};
  const Features features = random_features(scene, 40);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  std::vector<std::unique_ptr<Aligner>> devices;
  const std::vector<PixelFormat> device_formats{PixelFormat::r8, PixelFormat::rgba8, PixelFormat::bgra8, PixelFormat::r32f,
                                                PixelFormat::rgba32f};
  Plan plan = plan_for(scene.camera);
  const auto cpu = make_cpu_aligner(plan);
  for (PixelFormat format : device_formats) {
    plan.format = format;
    devices.push_back(make_device_aligner(device(), plan, {}, Solver::device));
  }
  for (uint32_t f = 0; f <= static_cast<uint32_t>(PixelFormat::rgba32f); ++f) {
    const auto format = static_cast<PixelFormat>(f);
    const auto pixels0 = encode(image0, format), pixels1 = encode(image1, format);
    const auto run = [&](Aligner& aligner) {
      aligner.set_reference(0, {{pixels0.data(), 130, 100, 0, format}, scene.camera, features, {}});
      return aligner.align(Pair{0, {pixels1.data(), 130, 100, 0, format}, {}, {}});
    };
    const Alignment expected = run(*cpu);
    EXPECT_TRUE(expected.converged()) << "host format " << f << ": " << expected.reason;
    EXPECT_LT(pixel_error(scene, features, expected.T_10), channels(format) == 1 ? 0.1 : 1.0);
    for (size_t d = 0; d < devices.size(); ++d) {
      const Alignment a = run(*devices[d]);
      // What was rounded to 8 bits on the way may be a little off; the rest is the same image.
      const bool exact =
          device_formats[d] == PixelFormat::r32f || device_formats[d] == PixelFormat::rgba32f ||
          (bytes_per_pixel(format) == static_cast<size_t>(channels(format)) && device_formats[d] != PixelFormat::r8) ||
          device_formats[d] == format;
      EXPECT_EQ(a.status, expected.status) << a.reason;
      EXPECT_LT(distance(a.T_10, expected.T_10, scene.distance), exact ? 2e-6 : 5e-4)
          << "host format " << f << ", device format " << static_cast<int>(device_formats[d]);
    }
  }
}

TEST(Formats, APlanOfAnotherFormatIsRefused) {
  ICLK_NEED_DEVICE();
  for (PixelFormat format :
       {PixelFormat::rgb8, PixelFormat::bgr8, PixelFormat::r16, PixelFormat::rgb16, PixelFormat::bgr16, PixelFormat::rgb32f}) {
    Plan plan{160, 120};
    plan.format = format;
    EXPECT_SAYS(refusal([&] { make_device_aligner(device(), plan); }),
                "Plan::format must be r8, rgba8, bgra8, r32f or rgba32f");
    EXPECT_SAYS(refusal([&] { DeviceAligner::workspace_size(*device(), plan, {}, Solver::host); }), "Plan::format");
  }
  EXPECT_SAYS(refusal([&] { make_device_aligner(device(), Plan{160, 120}, {}, Solver::cpu); }), "make_cpu_aligner");
}

// 8192x8192: where the device cannot hold it, the error has the numbers; where it can, the plan's size is known beforehand.
TEST(Size, AHugeImageFitsOrIsRefusedWithNumbers) {
  ICLK_NEED_DEVICE();
  Plan plan{8192, 8192};
  plan.format = PixelFormat::r8;
  for (bool dense : {false, true}) {
    plan.dense = dense;
    try {
      const auto bytes = DeviceAligner::workspace_size(*device(), plan, {}, Solver::device);
      EXPECT_GT(bytes.device, 8192u * 8192u * 2u);  // pixels of both images at least
      std::printf("  8192x8192 %s needs %.0f MiB and fits\n", dense ? "dense" : "sparse",
                  static_cast<double>(bytes.total()) / (1 << 20));
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::unsupported);
      EXPECT_SAYS(error.what(), "8192x8192");
      EXPECT_SAYS(error.what(), "bytes, but this device allows");
      std::printf("  %s\n", error.what());
      EXPECT_THROW(make_device_aligner(device(), plan), Error);
    }
  }
}

// More pairs than buffers can hold: the batch shrinks, the plan stands.
TEST(Size, WorkspaceIsWhatAPlanOfThisSizeTakes) {
  ICLK_NEED_DEVICE();
  Plan plan{160, 120};
  const auto one = DeviceAligner::workspace_size(*device(), plan, {}, Solver::device);
  plan.max_pairs = 8;
  const auto eight = DeviceAligner::workspace_size(*device(), plan, {}, Solver::device);
  EXPECT_GT(eight.device, one.device + 7 * 160 * 120 * (4 + 4));
  EXPECT_LT(eight.total(), one.total() + 7 * 160 * 120 * (4 + 4) * 2);
}

}  // namespace
}  // namespace iclk::test
