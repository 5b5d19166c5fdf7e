// The front door: one pair in one call, keyframes, batches, plans that grow with what a session is given, masks, errors.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include <gtest/gtest.h>
#include <iclk/iclk.h>
#include <iclk/session/feature_report.h>

#include "../support/device.h"
#include "../support/relief.h"

namespace iclk::test {
namespace {

SessionOptions on_cpu() { return {.model = "classical", .solver = Solver::cpu}; }

/// Two views of a relief with depth, grey floats.
struct Views {
  explicit Views(double turn = 0.01, int width = 160, int height = 120, uint32_t seed = 1) {
    relief.camera = {130, 130, (width - 1) / 2.0, (height - 1) / 2.0, width, height};
    relief.seed = seed;
    Vector6d xi;
    xi << 0.05, -0.03, 0.04, 0.01, turn, 0.02;
    relief.T_10 = SE3::exp(xi);
    image0 = render(relief, 0);
    image1 = render(relief, 1);
    depth = image0;
    for (int v = 0; v < height; ++v)
      for (int u = 0; u < width; ++u) depth.at(u, v) = static_cast<float>(relief.depth({u, v}));
    features = random_features(relief, 60);
  }
  Reference reference() const { return {image0.view(), relief.camera, features, {}}; }
  CascadePair pair() const { return {reference(), image1.view(), {}}; }

  Relief relief;
  Frame image0, image1, depth;
  Features features;
};

/// Grey values of 8 bits, in one channel or in three equal ones.
std::vector<uint8_t> bytes_of(const Frame& frame, int channels) {
  std::vector<uint8_t> bytes;
  for (const float I : frame.data)
    bytes.insert(bytes.end(), static_cast<size_t>(channels),
                 static_cast<uint8_t>(std::lround(255 * std::clamp(I, 0.0f, 1.0f))));
  return bytes;
}

ImageView view(const std::vector<uint8_t>& bytes, const Frame& like, PixelFormat format) {
  return {bytes.data(), like.width, like.height, 0, format};
}

void expect_same(const RefinedAlignment& a, const RefinedAlignment& b) {
  EXPECT_EQ(a.status, b.status) << a.reason << " / " << b.reason;
  EXPECT_EQ(a.T_10.matrix(), b.T_10.matrix());
  EXPECT_EQ(a.covariance, b.covariance);
}

template <typename F>
void expect_error(F statement, ErrorCode code, const std::string& piece) {
  try {
    statement();
    ADD_FAILURE() << "no error";
  } catch (const Error& e) {
    EXPECT_EQ(static_cast<int>(e.code()), static_cast<int>(code)) << e.what();
    EXPECT_NE(std::string(e.what()).find(piece), std::string::npos) << e.what();
  }
}

TEST(Session, OneCallAlignsAPairWithADepthImage) {
  const Views v(0.3);  // too far for ICLK without a search
  const Answer a = align(v.image0.view(), v.depth.view(), v.image1.view(), v.relief.camera, on_cpu());
  ASSERT_TRUE(a.converged()) << a.reason;
  EXPECT_LT((a.T_10.t - v.relief.T_10.t).norm(), 2e-3);
  EXPECT_EQ(a.model, "classical");
  const Features chosen = detect_features(v.image0.view(), v.depth.view(), {}, {});
  EXPECT_EQ(a.reference_features.uv, chosen.uv);
  EXPECT_EQ(a.reference_features.inverse_depth, chosen.inverse_depth);
  EXPECT_EQ(a.features.size(), chosen.uv.size());
  Eigen::Vector2d at;
  ASSERT_TRUE(feature_position(v.relief.camera, a.reference_features, a, 0, at));
  EXPECT_LT((at - v.relief.truth(chosen.uv[0])).norm(), 1);
}

TEST(Session, FeaturesOfOnesOwnAreThoseOfTheAnswer) {
  const Views v;
  SessionOptions options = on_cpu();
  options.depth_sigma = parse_depth_sigma("1%");
  const Answer with = align(v.reference(), v.image1.view(), options), without = align(v.reference(), v.image1.view(), on_cpu());
  ASSERT_TRUE(with.converged()) << with.reason;
  EXPECT_EQ(with.reference_features.uv, v.features.uv);
  EXPECT_EQ(with.reference_features.inverse_depth_sigma[3], 0.01 * v.features.inverse_depth[3]);
  EXPECT_NE(with.covariance, without.covariance);
  Session session(on_cpu());
  expect_same(without, session.align(v.pair()));
}

TEST(Session, AFirstGuessIsWhereAPairBegins) {
  const Views v;
  SE3 guess = v.relief.T_10;
  guess.t.x() += 0.02;
  SessionOptions off = on_cpu(), on = on_cpu();
  off.search = SearchMode::off;
  on.search = SearchMode::on;
  const Answer begun = align(v.reference(), v.image1.view(), on_cpu(), guess);
  expect_same(begun, align(v.reference(), v.image1.view(), off, guess));
  const SE3 searched = align(v.reference(), v.image1.view(), on, guess).iclk.T_10;
  EXPECT_NE(begun.iclk.T_10.matrix(), searched.matrix());
  const Views far(0.3);
  EXPECT_FALSE(align(far.reference(), far.image1.view(), off).converged());
  EXPECT_TRUE(align(far.reference(), far.image1.view(), on_cpu()).converged());
}

TEST(Session, KeyframesGiveWhatPairsGive) {
  const Views near, far(0.3, 160, 120, 5);
  SessionOptions options = on_cpu();
  options.references = 3;
  Session session(options);
  EXPECT_EQ(session.reference(2), nullptr);
  {
    const std::vector<float> gone = near.image0.data;  // keyframes are copies
    Reference reference = near.reference();
    reference.image.data = gone.data();
    EXPECT_EQ(session.set_reference(2, reference).size(), 60u);
  }
  session.set_reference(0, far.reference());
  EXPECT_EQ(session.reference(2)->features.uv, near.features.uv);
  const Pair pairs[] = {{0, far.image1.view(), {}, {}}, {2, near.image1.view(), {}, {}}, {0, far.image1.view(), {}, {}}};
  const std::vector<RefinedAlignment> results = session.align(pairs);
  ASSERT_EQ(results.size(), 3u);
  Session other(on_cpu());
  expect_same(results[0], other.align(far.pair()));
  expect_same(results[1], other.align(near.pair()));
  expect_same(results[2], results[0]);
  EXPECT_GT(session.times().align, 0);
  EXPECT_TRUE(session.align(std::span<const Pair>()).empty());
}

TEST(Session, KeyframesStayWhenAPlanGrows) {
  const Views first, second(0.02, 160, 120, 5);
  SessionOptions options = on_cpu();
  options.references = 2;
  Session session(options);
  const auto grey0 = bytes_of(first.image0, 1), grey1 = bytes_of(first.image1, 1);
  Reference small = first.reference();
  small.image = view(grey0, first.image0, PixelFormat::r8);
  small.features.uv.resize(20);
  small.features.inverse_depth.resize(20);
  session.set_reference(0, small);
  const Pair pair{0, view(grey1, first.image1, PixelFormat::r8), {}, {}};
  const RefinedAlignment before = session.align(pair);
  session.set_reference(1, second.reference());  // floats and more features
  expect_same(session.align(pair), before);      // the CPU reference computes in floats whatever the format
  const std::vector<uint8_t> all(160 * 120, 255);
  Pair masked = pair;
  masked.target_mask = {all.data(), 160, 120, 0, PixelFormat::r8};
  expect_same(session.align(masked), before);
  EXPECT_EQ(session.align(Pair{1, second.image1.view(), {}, {}}).status, Status::converged);
}

TEST(Session, BatchesAndSizesDoNotChangeAnAnswer) {
  const Views a, b(0.02, 160, 120, 5), large(0.02, 200, 150);
  SessionOptions options = on_cpu();
  options.batch = 2;
  Session session(options), single(on_cpu());
  const CascadePair pairs[] = {a.pair(), b.pair(), a.pair()};
  const std::vector<RefinedAlignment> results = session.align(pairs);
  ASSERT_EQ(results.size(), 3u);
  for (size_t i = 0; i < 3; ++i) expect_same(results[i], single.align(pairs[i]));
  const RefinedAlignment grown = session.align(large.pair());
  EXPECT_TRUE(grown.converged()) << grown.reason;
  expect_same(session.align(a.pair()), results[0]);
  EXPECT_TRUE(session.align(std::span<const CascadePair>()).empty());
}

TEST(Session, AMaskHidesWhatMoved) {
  const Views v;
  Views other(0.01, 160, 120, 9);
  Frame target = v.image1;
  std::vector<uint8_t> mask(160 * 120, 255);
  for (int row = 40; row < 90; ++row)
    for (int u = 60; u < 120; ++u) target.at(u, row) = other.image1.at(u, row), mask[static_cast<size_t>(row * 160 + u)] = 0;
  CascadePair pair = v.pair();
  pair.target = target.view();
  pair.target_mask = {mask.data(), 160, 120, 0, PixelFormat::r8};
  Session session(on_cpu());
  const RefinedAlignment r = session.align(pair);
  ASSERT_TRUE(r.converged()) << r.reason;
  for (const AlignedFeature& f : r.features) {
    if (f.status != FeatureStatus::aligned) continue;
    EXPECT_FALSE(f.uv1.x() > 60 && f.uv1.x() < 119 && f.uv1.y() > 40 && f.uv1.y() < 89) << f.uv1.transpose();
  }
}

TEST(Session, EverySolverAndFormatGivesThePose) {
  ICLK_NEED_DEVICE();
  const Views v;
  const auto grey0 = bytes_of(v.image0, 1), grey1 = bytes_of(v.image1, 1), colour0 = bytes_of(v.image0, 3),
             colour1 = bytes_of(v.image1, 3);
  for (const Solver solver : {Solver::host, Solver::device}) {
    Session session({.model = "classical", .solver = solver, .profile = true}, device());
    CascadePair grey = v.pair(), colour = v.pair();
    grey.reference.image = view(grey0, v.image0, PixelFormat::r8);
    grey.target = view(grey1, v.image1, PixelFormat::r8);
    colour.reference.image = view(colour0, v.image0, PixelFormat::rgb8);
    colour.target = view(colour1, v.image1, PixelFormat::rgb8);
    for (const CascadePair& pair : {v.pair(), grey, colour}) {
      const RefinedAlignment r = session.align(pair);
      ASSERT_TRUE(r.converged()) << r.reason;
      EXPECT_LT((r.T_10.t - v.relief.T_10.t).norm(), 2e-3);
    }
    EXPECT_EQ(session.stage_times().size(), 1u);
    EXPECT_EQ(session.device_name(), device()->info().name);
  }
}

TEST(Session, OtherModelsAreAskedInTheirOrder) {
  const Views near, far(0.3);
  SessionOptions options = on_cpu();
  AlignerOptions searching;
  searching.search = true;
  options.stages = {{}, {searching}};
  Session session(options);
  EXPECT_EQ(model_name(session.stages()), "auto");
  EXPECT_EQ(session.align(near.pair()).attempts.size(), 1u);
  const RefinedAlignment r = session.align(far.pair());
  EXPECT_TRUE(r.converged()) << r.reason;
  EXPECT_EQ(r.attempts.size(), 3u);  // the first, the same by local contrast, the second
  options.second_looks = false;
  EXPECT_EQ(Session(options).align(far.pair()).attempts.size(), 2u);
}

TEST(Session, TheVariableMayNameTheCpu) {
  const char* before = std::getenv("ICLK_DEVICE");
  const std::string kept = before ? before : "";
  setenv("ICLK_DEVICE", "cpu", 1);
  const Session session({.model = "classical"});
  before ? setenv("ICLK_DEVICE", kept.c_str(), 1) : unsetenv("ICLK_DEVICE");
  EXPECT_EQ(session.options().solver, Solver::cpu);
  EXPECT_EQ(session.context(), nullptr);
}

TEST(Session, ErrorsNameTheValue) {
  SessionOptions options = on_cpu();
  options.batch = 0;
  expect_error([&] { Session session(options); }, ErrorCode::invalid_argument, "batch 0");
  options = on_cpu();
  options.levels = 0;
  expect_error([&] { Session session(options); }, ErrorCode::invalid_argument, "levels");
  options = on_cpu();
  options.model = "no such model";
  expect_error([&] { Session session(options); }, ErrorCode::io, "no such model");
  expect_error([] { Session session({.model = "classical"}, nullptr); }, ErrorCode::invalid_argument, "Solver::cpu");
  expect_error([] { parse_search("far"); }, ErrorCode::invalid_argument, "auto, on, off");

  const Views v, large(0.01, 200, 150);
  Session session(on_cpu());
  EXPECT_EQ(session.device_name(), "CPU reference (one thread, no Vulkan)");
  const Pair pair{0, v.image1.view(), {}, {}};
  expect_error([&] { session.align(pair); }, ErrorCode::invalid_argument, "set_reference");
  session.set_reference(0, v.reference());
  expect_error([&] { session.set_reference(1, v.reference()); }, ErrorCode::invalid_argument, "1");
  expect_error([&] { session.set_reference(0, large.reference()); }, ErrorCode::invalid_argument, "200");
  expect_error([&] { session.align(Pair{0, large.image1.view(), {}, {}}); }, ErrorCode::invalid_argument, "200");
  expect_error([&] { session.align(v.image0.view(), large.depth.view(), v.image1.view(), v.relief.camera); },
               ErrorCode::invalid_argument, "200");
  expect_error([&] { session.expect(20, 20, 10); }, ErrorCode::invalid_argument, "20");
}

TEST(Session, ADepthImageWithoutDepthIsAStatus) {
  const Views v;
  Frame none = v.depth;
  std::fill(none.data.begin(), none.data.end(), 0.0f);
  const Answer a = align(v.image0.view(), none.view(), v.image1.view(), v.relief.camera, on_cpu());
  EXPECT_EQ(a.status, Status::too_few_features);
  EXPECT_EQ(a.reference_features.size(), 0);
}

TEST(Session, TheCpuCanBeNamedAsTheDevice) {
  const Session session({.model = "classical", .device = "cpu"});
  EXPECT_EQ(session.context(), nullptr);
  EXPECT_EQ(session.options().solver, Solver::cpu);
}

}  // namespace
}  // namespace iclk::test
