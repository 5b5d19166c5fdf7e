// Every variant of the device's 3x3 convolution against a plain one.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <iclk/align/network/convolution.h>
#include <iclk/engine/submission.h>

#include "device.h"
#include "plain_network.h"

namespace iclk {
namespace {

using internal::ConvKernels;
using internal::ConvStep;
using internal::ConvVariant;
using internal::TensorLayout;

struct Shape {
  uint32_t width, height;
  int in, out, dilation;
  uint32_t images = 1;
};
void PrintTo(const Shape& s, std::ostream* out) {
  *out << s.width << "x" << s.height << " " << s.in << "->" << s.out << " dilation " << s.dilation << " images " << s.images;
}

struct Way {
  ConvVariant variant;
  bool shuffle;
  bool fused = false;
};
std::string text(const Way& way) {
  return name(way.variant) + std::string(way.shuffle ? "" : "_plain") + (way.fused ? "_fused" : "");
}
void PrintTo(const Way& way, std::ostream* out) { *out << text(way); }

size_t at(const TensorLayout& t, uint32_t image, uint32_t c, uint32_t v, uint32_t u) {
  return 4 * (t.offset() + static_cast<size_t>(image) * t.image() + (c / 4) * static_cast<size_t>(t.plane()) + v * t.pitch() +
              u) +
         c % 4;
}

class Convolution : public testing::TestWithParam<std::tuple<Way, Shape>> {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }
};
class ReducedConvolution : public Convolution {};

constexpr double kTolerance = 2e-5;  // of outputs of the order of 1

ConvStep step_for(const Way& way, const Shape& shape) {
  const uint32_t border = static_cast<uint32_t>(shape.dilation) + 1;  // more than needed is right as well
  ConvStep step;
  step.variant = way.variant;
  step.in = {shape.width, shape.height, static_cast<uint32_t>(shape.in), shape.images, border};
  step.out = {shape.width, shape.height, static_cast<uint32_t>(shape.out), shape.images, border};
  step.dilation = static_cast<uint32_t>(shape.dilation);
  step.fused = way.fused;
  return step;
}

// What a step makes of random images in `bytes` of memory, and the plain convolution of each of them.
struct Outcome {
  std::vector<float> made;
  std::vector<float> maps[2];  // of the first image, and of the others, one too late
  std::vector<std::vector<double>> expected;
};
Outcome run(const Way& way, const Shape& shape, ConvStep step, uint64_t bytes, const internal::MapPlace& place = {}) {
  const auto context = way.variant == ConvVariant::direct && !way.shuffle ? test::device_without_subgroups() : test::device();
  std::mt19937 random(7);
  const ConvLayer layer = test::random_layer(shape.in, shape.out, shape.dilation, random);
  internal::PackedWeights packed;
  packed.add(layer, way.variant);  // the layer under test lies behind another
  step.packed = packed.add(layer, way.variant);

  using engine::MemoryKind;
  const auto use = ConvKernels::kActivations;
  const auto texel = VK_FORMAT_R32G32B32A32_SFLOAT;
  engine::MemoryPlan plan;
  const auto in = plan.add("in", 16 * step.in.texels(), MemoryKind::upload, use, texel);
  const auto weights = plan.add("weights", 4 * packed.data().size(), MemoryKind::device, ConvKernels::kWeights, texel);
  const auto out = plan.add("out", bytes, MemoryKind::readback, use, texel);
  const auto scratch = plan.add("scratch", 16 * std::max<uint64_t>(1, ConvKernels::scratch_texels(step)), MemoryKind::device,
                                ConvKernels::kScratch, texel);
  const uint64_t map_bytes = std::max<uint64_t>(16, 4ull * place.stride * (shape.images + 1));
  const engine::BufferId maps[] = {plan.add("map", map_bytes, MemoryKind::readback, engine::BufferUse::storage),
                                   plan.add("other maps", map_bytes, MemoryKind::readback, engine::BufferUse::storage)};
  const engine::Workspace memory(context, plan);
  internal::write_buffer(context, memory[weights], packed.data());

  // Whatever is not written must not matter, in the padding channels of the input neither.
  std::fill_n(memory[in].as<float>(), memory[in].size / 4, std::numeric_limits<float>::quiet_NaN());
  for (const engine::BufferId id : {out, maps[0], maps[1]})
    std::fill_n(memory[id].as<float>(), memory[id].size / 4, std::numeric_limits<float>::quiet_NaN());
  const size_t image = static_cast<size_t>(shape.in) * shape.width * shape.height;
  std::vector<float> x(image * shape.images);
  std::normal_distribution<float> normal;
  for (float& value : x) value = normal(random);
  for (uint32_t n = 0; n < shape.images; ++n)
    for (uint32_t c = 0; c < 4 * step.in.planes(); ++c)
      for (uint32_t v = 0; v < shape.height; ++v)
        for (uint32_t u = 0; u < shape.width; ++u)
          memory[in].as<float>()[at(step.in, n, c, v, u)] =
              c < step.in.channels ? x[n * image + (c * shape.height + v) * shape.width + u] : 0.0f;

  const ConvKernels kernels(context, std::span(&step, 1));
  engine::ArenaSize size;
  kernels.add_to(size);
  engine::DescriptorArena arena(context, size);
  engine::Submission submission(context);
  engine::Recorder recorder(submission, arena);
  kernels.record_borders(recorder, step.in, step.reduced ? TensorLayout{} : step.out, memory[in], memory[out]);
  if (step.fused) kernels.record_start(recorder, memory[scratch]);
  const internal::MapPart parts[] = {{&memory[maps[0]], 0, 1, 0}, {&memory[maps[1]], 1, shape.images - 1, 2}};
  kernels.record(recorder, step, memory[in], memory[weights], memory[out], memory[scratch], place,
                 std::span(parts).first(shape.images > 1 ? 2 : 1));
  recorder.host_read({&memory[out], &memory[maps[0]], &memory[maps[1]]});
  submission.end();
  submission.submit_and_wait();

  Outcome outcome;
  const auto values = [&](engine::BufferId id) {
    return std::vector<float>(memory[id].as<const float>(), memory[id].as<const float>() + memory[id].size / 4);
  };
  outcome.made = values(out);
  for (size_t i = 0; i < 2; ++i) outcome.maps[i] = values(maps[i]);
  for (uint32_t n = 0; n < shape.images; ++n) {
    test::PlainMaps channels(static_cast<int>(shape.width), static_cast<int>(shape.height), shape.in);
    std::copy_n(&x[n * image], image, channels.data.begin());
    outcome.expected.push_back(test::convolve(channels, layer).data);
  }
  return outcome;
}

// What the device does not have that this way needs.
const char* lacking(const Way& way, const ConvStep& step) {
  const auto context = test::device();
  if (way.shuffle && !internal::can_shuffle(context->info())) return "no subgroup shuffles here";
  return way.fused && !internal::can_fuse(step, *context) ? "not a CPU with shuffles" : nullptr;
}

TEST_P(Convolution, IsThePlainOne) {
  const auto [way, shape] = GetParam();
  const ConvStep step = step_for(way, shape);
  if (const char* why = lacking(way, step)) GTEST_SKIP() << why;
  const Outcome outcome = run(way, shape, step, 16 * step.out.texels());
  const uint32_t border = step.out.border;
  for (uint32_t n = 0; n < shape.images; ++n)
    for (uint32_t c = 0; c < 4 * step.out.planes(); ++c)
      for (uint32_t v = 0; v < shape.height + border; ++v)
        for (uint32_t u = 0; u < shape.width + border; ++u) {
          const bool inside = c < step.out.channels && v < shape.height && u < shape.width;
          const double e = inside ? outcome.expected[n][(c * shape.height + v) * shape.width + u] : 0.0;
          ASSERT_NEAR(outcome.made[at(step.out, n, c, v, u)], e, kTolerance * std::max(1.0, std::abs(e)))
              << "image " << n << " channel " << c << " at " << u << ", " << v;
        }
}

TEST_P(ReducedConvolution, MakesMeansAndSumsOrMapsOfThePlainOne) {
  const auto [way, shape] = GetParam();
  ConvStep step = step_for(way, shape);
  if (const char* why = lacking(way, step)) GTEST_SKIP() << why;
  ASSERT_TRUE(internal::can_reduce(step));
  step.reduced = true;
  step.half = step.out;
  step.half.width /= 2;
  step.half.height /= 2;
  for (const bool halves : {true, false}) {
    if (!halves) step.half = {};
    const internal::ChannelSums sums = internal::channel_sums(step);
    // Rows that are written four pixels at a time, and some pixels of rows that cannot be.
    const bool whole = step.whole_map = halves;
    const uint32_t w = shape.width, h = shape.height, pitch = whole ? (w + 3) / 4 * 4 : w + 1;
    const internal::MapPlace place =
        whole ? internal::MapPlace{4, pitch, pitch * h + 8, 0, 0, w, h}
              : internal::MapPlace{3, pitch, pitch * h + 5, w > 1, h > 1, w > 2 ? w - 1 : w, h > 2 ? h - 1 : h};
    ASSERT_EQ(place.whole(w), whole);
    const Outcome outcome = run(way, shape, step, 16 * sums.texels(shape.images), place);
    for (uint32_t n = 0; n < shape.images; ++n) {
      const auto expected = [&](uint32_t c, uint32_t v, uint32_t u) {
        return c < step.out.channels ? outcome.expected[n][(c * shape.height + v) * shape.width + u] : 0.0;
      };
      // A sum of eight may be as far off as each of them.
      const double off = kTolerance;
      for (uint32_t c = 0; step.half.width > 0 && c < 4 * step.out.planes(); ++c)
        for (uint32_t v = 0; v < step.half.height + step.half.border; ++v)
          for (uint32_t u = 0; u < step.half.width + step.half.border; ++u) {
            if (v >= step.half.height || u >= step.half.width) {
              ASSERT_TRUE(std::isnan(outcome.made[at(step.half, n, c, v, u)])) << "border, at " << u << ", " << v;
              continue;
            }
            const uint32_t x = 2 * u, y = 2 * v;
            const double e =
                (expected(c, y, x) + expected(c, y, x + 1) + expected(c, y + 1, x) + expected(c, y + 1, x + 1)) / 4.0;
            ASSERT_NEAR(outcome.made[at(step.half, n, c, v, u)], e, off * std::max(1.0, std::abs(e)))
                << "image " << n << " channel " << c << " at " << u << ", " << v;
          }
      if (internal::writes_map(step)) {
        for (uint32_t v = 0; v < h; ++v)
          for (uint32_t u = 0; u < w; ++u) {
            double e = 0;
            for (uint32_t c = 0; c < step.out.channels; ++c) e += expected(c, v, u) / step.out.channels;
            const float made = outcome.maps[n > 0][place.offset + (n > 0 ? n + 1 : 0) * place.stride + v * pitch + u];
            if (u < place.first_u || u >= place.end_u || v < place.first_v || v >= place.end_v)
              ASSERT_TRUE(std::isnan(made)) << "not asked for, at " << u << ", " << v;
            else
              ASSERT_NEAR(made, e, off * std::max(1.0, std::abs(e))) << "map of image " << n << " at " << u << ", " << v;
          }
        continue;
      }
      for (uint32_t block = 0; block < sums.planes; ++block)
        for (uint32_t v = 0; v < shape.height; ++v)
          for (uint32_t u = 0; u < shape.width; ++u) {
            double e = 0;
            for (uint32_t c = 8 * block; c < 8 * block + 8; ++c) e += expected(c, v, u);
            const size_t texel =
                sums.offset + (n * sums.planes + block) * static_cast<size_t>(sums.plane) + v / 2 * sums.pitch + u / 2;
            ASSERT_NEAR(outcome.made[4 * texel + v % 2 * 2 + u % 2], e, 8 * off * std::max(1.0, std::abs(e)))
                << "image " << n << " channels from " << 8 * block << " at " << u << ", " << v;
          }
    }
  }
}

constexpr Way kWays[] = {{ConvVariant::direct, true},
                         {ConvVariant::direct, false},
                         {ConvVariant::winograd4x1, true},
                         {ConvVariant::winograd4x1, true, true},
                         {ConvVariant::winograd4, true, true}};

std::string test_name(const testing::TestParamInfo<std::tuple<Way, Shape>>& info) {
  const auto& [way, s] = info.param;
  return text(way) + "_" + std::to_string(s.width) + "x" + std::to_string(s.height) + "_" + std::to_string(s.in) + "to" +
         std::to_string(s.out) + "_d" + std::to_string(s.dilation) + "_n" + std::to_string(s.images);
}

// The paper's layers, at sizes that leave no tile whole.
INSTANTIATE_TEST_SUITE_P(
    Paper, Convolution,
    testing::Combine(testing::ValuesIn(kWays),
                     testing::Values(Shape{47, 30, 3, 16, 1}, Shape{47, 30, 16, 32, 2}, Shape{47, 30, 32, 32, 2},
                                     Shape{23, 15, 32, 64, 1}, Shape{23, 15, 64, 64, 2}, Shape{23, 15, 64, 96, 1},
                                     Shape{23, 15, 96, 96, 2}, Shape{11, 7, 96, 128, 1}, Shape{11, 7, 128, 128, 2})),
    test_name);
INSTANTIATE_TEST_SUITE_P(Odd, Convolution,
                         testing::Combine(testing::ValuesIn(kWays),
                                          testing::Values(Shape{1, 1, 1, 1, 1}, Shape{2, 9, 5, 7, 2}, Shape{37, 3, 1, 9, 3},
                                                          Shape{16, 16, 4, 8, 4}, Shape{13, 11, 6, 13, 7},
                                                          Shape{19, 13, 5, 12, 2, 3}, Shape{65, 17, 9, 20, 1, 2},
                                                          Shape{193, 129, 5, 9, 1})),
                         test_name);

// Large enough for the tallest tiles of a GPU.
INSTANTIATE_TEST_SUITE_P(Tall, Convolution,
                         testing::Combine(testing::Values(Way{ConvVariant::direct, false}),
                                          testing::Values(Shape{753, 357, 3, 8, 1}, Shape{753, 361, 4, 9, 2})),
                         test_name);

// So many channels that a fused item cannot have all of them: lavapipe ends the loops of an invocation after 65,535 turns.
// The tiles of 256 sub-grids are items enough for four threads, which get no fewer channels for want of items.
INSTANTIATE_TEST_SUITE_P(Deep, Convolution,
                         testing::Combine(testing::Values(Way{ConvVariant::winograd4, true, true}),
                                          testing::Values(Shape{16, 16, 256, 480, 16}, Shape{16, 16, 256, 968, 16})),
                         test_name);

// Odd sizes, where means are of fewer pixels than maps; of odd dilations winograd4x1_fused can reduce 1.
INSTANTIATE_TEST_SUITE_P(Winograd, ReducedConvolution,
                         testing::Combine(testing::ValuesIn(std::span(kWays).subspan(3, 2)),
                                          testing::Values(Shape{47, 30, 32, 32, 2}, Shape{23, 15, 64, 64, 2, 2},
                                                          Shape{11, 7, 128, 128, 2}, Shape{1, 1, 1, 1, 2}, Shape{2, 9, 5, 7, 2},
                                                          Shape{16, 16, 4, 8, 4}, Shape{33, 19, 6, 13, 6, 3})),
                         test_name);
INSTANTIATE_TEST_SUITE_P(Undilated, ReducedConvolution,
                         testing::Combine(testing::Values(Way{ConvVariant::winograd4x1, true, true}),
                                          testing::Values(Shape{47, 30, 3, 8, 1}, Shape{193, 129, 3, 16, 1, 2},
                                                          Shape{1, 1, 1, 1, 1}, Shape{9, 8, 64, 60, 1, 3},
                                                          Shape{2, 2, 5, 7, 1})),
                         test_name);

}  // namespace
}  // namespace iclk
