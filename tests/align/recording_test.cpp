// record(): alignments in the command buffer of an application that owns device, queue, images and buffers.
#include <algorithm>

#include <iclk/align/device_recording.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/error.h>
#include <iclk/shaders/shared.h>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

std::vector<uint8_t> bytes_of(const Frame& frame, int channels) {
  std::vector<uint8_t> out;
  for (float I : frame.data)
    for (int c = 0; c < channels; ++c)
      out.push_back(c == 3 ? 255 : static_cast<uint8_t>(std::lround(255 * std::clamp(I, 0.0f, 1.0f))));
  return out;
}

Relief moved(double t, double turn, uint32_t seed) {
  Relief scene;
  scene.seed = seed;
  scene.T_10.t = {t, -0.5 * t, t};
  scene.T_10.R = SE3::exp((Vector6d() << 0, 0, 0, turn, -turn, 2 * turn).finished()).R;
  return scene;
}

// The words of a ResultInfo a pair, as a shader or a copy that follows in the same command buffer would see them.
struct ReadResults {
  ReadResults(const std::shared_ptr<Context>& context, size_t pairs) : arena(context, {}) {
    MemoryPlan plan;
    id = plan.add("results", pairs * sizeof(shaders::ResultInfo), MemoryKind::readback, BufferUse::transfer);
    memory = Workspace(context, plan);
  }
  void record(const Context& context, VkCommandBuffer commands, const Buffer& results) {
    Recorder recorder(context, commands, arena);
    recorder.copy(results, memory[id], memory[id].size);
    recorder.host_read({&memory[id]});
  }
  const shaders::ResultInfo& operator[](size_t i) const { return memory[id].as<const shaders::ResultInfo>()[i]; }

  DescriptorArena arena;
  BufferId id;
  Workspace memory;
};

void expect_agrees(const shaders::ResultInfo& info, const Alignment& a) {
  EXPECT_EQ(info.status, static_cast<uint32_t>(a.status)) << a.reason;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(info.pose[4 * i + j], a.T_10.R(i, j), 1e-6);
    EXPECT_NEAR(info.pose[4 * i + 3], a.T_10.t(i), 1e-6);
  }
  EXPECT_NEAR(info.gain, a.gain, 1e-6);
  EXPECT_NEAR(info.bias, a.bias, 1e-6);
  EXPECT_NEAR(info.cost, a.cost, 1e-6);
  EXPECT_NEAR(info.correlation, a.correlation, 1e-4);
  EXPECT_NEAR(info.visible_fraction, a.visible_fraction, 1e-6);
  const Eigen::Matrix<float, 6, 6, Eigen::RowMajor> covariance(info.covariance);
  EXPECT_LE((covariance.cast<double>() - a.covariance).norm(), 1e-3 * a.covariance.norm());
}

constexpr size_t kBytes = 160 * 120 * 4;

TEST(Recording, TwoAlignmentsInOneCommandBufferAreThoseOfAlign) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief a = moved(0.05, 0.01, 1), b = moved(-0.04, -0.012, 2);
  const Features fa = random_features(a, 50, 1), fb = random_features(b, 40, 2);
  const auto a0 = bytes_of(render(a, 0), 4), a1 = bytes_of(render(a, 1), 4), b0 = bytes_of(render(b, 0), 4),
             b1 = bytes_of(render(b, 1), 4);
  const auto view = [](const std::vector<uint8_t>& pixels) {
    return ImageView{pixels.data(), 160, 120, 0, PixelFormat::rgba8};
  };

  Plan plan = plan_for(a.camera);
  plan.format = PixelFormat::rgba8;
  plan.max_references = plan.max_pairs = 2;
  DeviceAligner aligner(context, plan, {}, Solver::device);
  aligner.set_reference(0, {view(a0), a.camera, fa, {}});
  aligner.set_reference(1, {view(b0), b.camera, fb, {}});
  const auto expected = aligner.align(std::vector<Pair>{{0, view(a1), {}, {}}, {1, view(b1), {}, {}}});
  ASSERT_TRUE(expected[0].converged() && expected[1].converged());
  EXPECT_LT(pixel_error(a, fa, expected[0].T_10), 0.05);

  ApplicationImage image_a0(app, 160, 120, VK_FORMAT_R8G8B8A8_UNORM, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL);
  ApplicationImage image_a1(app, 160, 120, VK_FORMAT_R8G8B8A8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
  ApplicationImage image_b1(app, 160, 120, VK_FORMAT_R8G8B8A8_SRGB, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL);
  image_a0.fill(context, a0.data(), kBytes);
  image_a1.fill(context, a1.data(), kBytes);
  image_b1.fill(context, b1.data(), kBytes);
  // The other reference lies in a buffer with longer rows, at an offset.
  MemoryPlan buffers;
  const BufferId id = buffers.add("reference", 64 + 170 * 120 * 4, MemoryKind::upload, BufferUse::transfer);
  const Workspace memory(context, buffers);
  for (size_t v = 0; v < 120; ++v) std::memcpy(memory[id].as<uint8_t>() + 64 + 170 * 4 * v, &b0[160 * 4 * v], 160 * 4);
  const DeviceBufferImage buffer_b0{memory[id].handle, memory[id].size, 64, 170};

  DeviceAligner recorder(context, plan, {}, Solver::device);
  const auto first = recorder.make_recording(), second = recorder.make_recording();
  ReadResults results0(context, 1), results1(context, 1);
  const ApplicationCommands host(app);
  const DeviceReference ra{0, image_a0.foreign, a.camera, fa}, rb{1, buffer_b0, b.camera, fb};
  const DevicePair pa{0, image_a1.foreign, {}, {}}, pb{1, image_b1.foreign, {}, {}};
  recorder.record(*first, host.commands, {&ra, 1}, {&pa, 1});
  results0.record(*context, host.commands, first->results());
  recorder.record(*second, host.commands, {&rb, 1}, {&pb, 1});
  results1.record(*context, host.commands, second->results());
  host.end();
  for (int run = 0; run < 2; ++run) {
    host.submit_and_wait();
    EXPECT_TRUE(same_bits(first->read().at(0), expected[0])) << run << ": " << first->read()[0].reason;
    EXPECT_TRUE(same_bits(second->read().at(0), expected[1])) << run << ": " << second->read()[0].reason;
    expect_agrees(results0[0], expected[0]);
    expect_agrees(results1[0], expected[1]);
  }
  // Both pairs in one recording, against the slots that are prepared by now.
  const auto both = recorder.make_recording(2);
  const ApplicationCommands again(app);
  recorder.record(*both, again.commands, {}, std::vector{pb, pa});
  again.end();
  again.submit_and_wait();
  EXPECT_TRUE(same_bits(both->read().at(0), expected[1]));
  EXPECT_TRUE(same_bits(both->read().at(1), expected[0]));
}

TEST(Recording, TheSameCommandsSeeNewPixels) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief near = moved(0.03, 0.008, 1), far = moved(-0.05, -0.01, 1);
  const Features features = random_features(near, 50);
  const auto image0 = bytes_of(render(near, 0), 1), target = bytes_of(render(near, 1), 1), other = bytes_of(render(far, 1), 1);
  const std::vector<uint8_t> grey(160 * 120, 128);
  Plan plan = plan_for(near.camera);
  plan.format = PixelFormat::r8;
  for (int max_features : {50, kSplitFeatures}) {  // iterate.comp; normal_equations.comp and lm_step.comp
    plan.max_features = max_features;
    AlignerOptions options;
    options.robust = Robust::huber;
    DeviceAligner aligner(context, plan, options, Solver::device);
    // The keyframe comes from the host and is prepared within the recording.
    aligner.set_reference(0, {{image0.data(), 160, 120, 0, PixelFormat::r8}, near.camera, features, {}});
    ApplicationImage image(app, 160, 120, VK_FORMAT_R8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
    const auto recording = aligner.make_recording();
    ReadResults results(context, 1);
    const ApplicationCommands host(app);
    const DevicePair pair{0, image.foreign, {}, {}};
    aligner.record(*recording, host.commands, {}, {&pair, 1});
    results.record(*context, host.commands, recording->results());
    host.end();
    const Relief* truths[] = {&near, &far, &near};
    SE3 first;
    for (int i = 0; i < 3; ++i) {
      image.fill(context, i == 1 ? other.data() : target.data(), 160 * 120);
      host.submit_and_wait();
      const Alignment a = recording->read().at(0);
      EXPECT_TRUE(a.converged()) << a.reason;
      EXPECT_LT(pixel_error(*truths[i], features, a.T_10), 0.05) << i;
      expect_agrees(results[0], a);
      if (i == 0) first = a.T_10;
      EXPECT_EQ(a.T_10.R == first.R && a.T_10.t == first.t, i != 1);
    }
    image.fill(context, grey.data(), 160 * 120);
    host.submit_and_wait();
    EXPECT_FALSE(recording->read().at(0).converged());
    EXPECT_NE(results[0].status, static_cast<uint32_t>(Status::converged));
    // The aligner itself goes on working.
    EXPECT_TRUE(aligner.align(Pair{0, {target.data(), 160, 120, 0, PixelFormat::r8}, {}, {}}).converged());
  }
}

TEST(Recording, TooFewFeaturesAreAResultToo) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief scene;
  const auto pixels = bytes_of(render(scene, 0), 4);
  Plan plan = plan_for(scene.camera);
  plan.format = PixelFormat::rgba8;
  DeviceAligner aligner(context, plan, {}, Solver::device);
  ApplicationImage image(app, 160, 120, VK_FORMAT_R8G8B8A8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
  image.fill(context, pixels.data(), kBytes);
  const auto recording = aligner.make_recording();
  ReadResults results(context, 1);
  const ApplicationCommands host(app);
  SE3 start;
  start.t.x() = 0.5;
  const DeviceReference reference{0, image.foreign, scene.camera, random_features(scene, 3)};
  const DevicePair pair{0, image.foreign, start, {}};
  aligner.record(*recording, host.commands, {&reference, 1}, {&pair, 1});
  results.record(*context, host.commands, recording->results());
  host.end();
  host.submit_and_wait();
  EXPECT_EQ(recording->read().at(0).status, Status::too_few_features);
  EXPECT_EQ(results[0].status, static_cast<uint32_t>(Status::too_few_features));
  EXPECT_EQ(results[0].pose[3], 0.5f);
}

// The shader's verdict and the host's are the same where a pair fails.
TEST(Recording, FailuresHaveTheSameStatusInTheBuffer) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief scene = moved(0.03, 0.008, 1);
  const Features features = random_features(scene, 50);
  const auto image0 = bytes_of(render(scene, 0), 1), image1 = bytes_of(render(scene, 1), 1);
  const std::vector<uint8_t> grey(160 * 120, 128);
  // What decides these is in the gradients: edges of one direction in the noise of 8 bits, and a target of another scene.
  Relief edges = scene, other = scene;
  edges.direction = 0.1;
  edges.noise = 0.01;
  other.seed = 7;
  const auto edges0 = bytes_of(render(edges, 0), 1), edges1 = bytes_of(render(edges, 1), 1);
  const auto unrelated = bytes_of(render(other, 1), 1);
  const auto chequered0 = bytes_of(chequered(160, 120, 0, 1), 1), chequered1 = bytes_of(chequered(160, 120, 2, 2), 1);
  SE3 away;
  away.t.x() = 100;
  struct Case {
    const std::vector<uint8_t>*reference, *target;
    SE3 start;
    int levels, iterations;
    Status status;
    double prior = 0;  // its information
    bool search = false;
  };
  for (const Case& c :
       {Case{&image0, &image1, {}, 4, 10, Status::converged}, Case{&image0, &image1, {}, 1, 1, Status::max_iterations},
        Case{&image0, &image1, away, 4, 10, Status::low_overlap}, Case{&grey, &image1, {}, 4, 10, Status::degenerate},
        Case{&edges0, &edges1, {}, 4, 10, Status::degenerate}, Case{&edges0, &edges1, {}, 4, 10, Status::converged, 1e6},
        Case{&image0, &unrelated, {}, 4, 10, Status::diverged}, Case{&chequered0, &chequered1, {}, 4, 10, Status::converged},
        Case{&chequered0, &chequered1, {}, 4, 10, Status::degenerate, 0, true},
        Case{&image0, &image1, {}, 4, 10, Status::converged, 0, true}}) {
    Plan plan = plan_for(scene.camera);
    plan.format = PixelFormat::r8;
    AlignerOptions options;
    options.levels = c.levels;
    options.iterations = c.iterations;
    options.search = c.search;
    DeviceAligner aligner(context, plan, options, Solver::device);
    aligner.set_reference(0, {{c.reference->data(), 160, 120, 0, PixelFormat::r8}, scene.camera, features, {}});
    ApplicationImage image(app, 160, 120, VK_FORMAT_R8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
    image.fill(context, c.target->data(), 160 * 120);
    const auto recording = aligner.make_recording();
    ReadResults results(context, 1);
    const ApplicationCommands host(app);
    DevicePair pair{0, image.foreign, c.start, {}};
    if (c.prior > 0) pair.prior = PosePrior{scene.T_10, c.prior * Matrix6d::Identity()};
    aligner.record(*recording, host.commands, {}, {&pair, 1});
    results.record(*context, host.commands, recording->results());
    host.end();
    host.submit_and_wait();
    const Alignment a = recording->read().at(0);
    // Where a target that is unrelated leads depends on the last bits, and so on the size of a device's workgroups.
    if (c.target == &unrelated)
      EXPECT_TRUE(a.status == Status::diverged || a.status == Status::low_overlap) << name(a.status) << a.reason;
    else
      EXPECT_STREQ(name(a.status), name(c.status)) << a.reason;
    EXPECT_EQ(results[0].status, static_cast<uint32_t>(a.status)) << name(c.status);
    if (a.covariance != Matrix6d::Zero()) expect_agrees(results[0], a);
  }
}

// What is not recordable is refused before a command is written: the command buffer stays usable.
TEST(Recording, WhatCannotBeRecordedIsRefusedByName) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief scene;
  Plan plan = plan_for(scene.camera);
  plan.format = PixelFormat::rgba8;
  plan.max_pairs = 2;
  DeviceAligner aligner(context, plan, {}, Solver::device);
  const ApplicationImage image(app, 160, 120, VK_FORMAT_R8G8B8A8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
  const auto recording = aligner.make_recording();
  const ApplicationCommands host(app);
  const DeviceReference reference{0, image.foreign, scene.camera, random_features(scene, 20)};
  const DevicePair pair{0, image.foreign, {}, {}};

  const auto refused = [&](auto change, ErrorCode code = ErrorCode::invalid_argument,
                           DeviceAligner* with = nullptr) -> std::string {
    std::vector<DeviceReference> references{reference};
    std::vector<DevicePair> pairs{pair};
    change(references, pairs);
    try {
      (with ? *with : aligner).record(*recording, host.commands, references, pairs);
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), code) << error.what();
      return error.what();
    }
    return "accepted";
  };
  using References = std::vector<DeviceReference>;
  using Pairs = std::vector<DevicePair>;
  const auto expect = [](const std::string& message, const std::string& part) {
    EXPECT_NE(message.find(part), std::string::npos) << message;
  };
  const auto foreign = [](DeviceImage& i) -> ForeignImage& { return std::get<ForeignImage>(i); };

  expect(refused([&](References&, Pairs& p) { p.push_back(pair); }), "2 pairs: the recording allows 1 to 1");
  expect(refused([&](References&, Pairs& p) { p.clear(); }), "0 pairs");
  expect(refused([&](References& r, Pairs&) { r[0].slot = 1; }), "slot 1 is outside the range of the plan, 0 to 0");
  expect(refused([&](References&, Pairs& p) { p[0].reference = -1; }), "slot -1");
  expect(refused([&](References& r, Pairs&) { r.clear(); }), "slot 0 was never set");
  expect(refused([&](References& r, Pairs&) { r[0].camera.width = 161; }), "161x120");
  expect(refused([&](References& r, Pairs&) { r[0].camera.fx = 0; }), "focal length");
  expect(refused([&](References& r, Pairs&) { r[0].features = random_features(scene, 51); }),
         "51 features, but the plan has room for 50");
  expect(refused([&](References& r, Pairs&) { foreign(r[0].image).handle = VK_NULL_HANDLE; }), "VkImage is null");
  expect(refused([&](References&, Pairs& p) { foreign(p[0].target).handle = VK_NULL_HANDLE; }),
         "pair 0, target: the VkImage is null");
  expect(refused([&](References&, Pairs& p) { foreign(p[0].target).width = 80; }), "80x120, but the plan was made for 160x120");
  expect(refused([&](References&, Pairs& p) { foreign(p[0].target).format = VK_FORMAT_B8G8R8A8_UNORM; }),
         "not the plan's pixel format");
  expect(refused([&](References&, Pairs& p) { p[0].target = DeviceBufferImage{}; }), "VkBuffer is null");
  expect(refused([&](References&, Pairs& p) { p[0].T_10.t.x() = NAN; }), "initial pose is not finite");
  expect(refused([&](References&, Pairs& p) { p[0].T_10.R *= 2; }), "determinant");
  PosePrior prior;
  prior.information(0, 1) = 1;
  expect(refused([&](References&, Pairs& p) { p[0].prior = prior; }), "not symmetric");
  expect(refused([&](References& r, Pairs&) { r[0].features.inverse_depth.pop_back(); }),
         "20 feature pixels but 19 inverse depths");
  expect(refused([&](References&, Pairs& p) { foreign(p[0].target).layout = VK_IMAGE_LAYOUT_UNDEFINED; }), "layout");
  MemoryPlan buffers;
  const BufferId id = buffers.add("pixels", kBytes, MemoryKind::upload, BufferUse::transfer);
  const Workspace memory(context, buffers);
  const auto buffer = [&](VkDeviceSize size, VkDeviceSize offset, uint32_t row) {
    return refused([&](References&, Pairs& p) { p[0].target = DeviceBufferImage{memory[id].handle, size, offset, row}; });
  };
  expect(buffer(kBytes - 4, 0, 0), "needs 76800");
  expect(buffer(kBytes, 4, 0), "76800 bytes, but the image at offset 4 (a multiple of 4) needs 76804");
  expect(buffer(kBytes, 2, 0), "multiple of 4");
  expect(buffer(kBytes, 0, 159), "rows of 159 pixels");
  expect(buffer(kBytes, 0, 161), "needs");
  expect(buffer(kBytes, VkDeviceSize(0) - 4, 0), "needs");

  EXPECT_THROW(aligner.make_recording(0), Error);
  EXPECT_THROW(aligner.make_recording(3), Error);
  DeviceAligner host_solver(context, plan, {}, Solver::host);
  expect(refused([](References&, Pairs&) {}, ErrorCode::invalid_argument, &host_solver), "Solver::device");
  plan.dense = true;
  DeviceAligner dense(context, plan, {}, Solver::device);
  expect(refused([](References&, Pairs&) {}, ErrorCode::unsupported, &dense), "sparse");
  plan.dense = false;
  plan.width = 176;
  DeviceAligner wider(context, plan, {}, Solver::device);
  expect(refused([](References&, Pairs&) {}, ErrorCode::invalid_argument, &wider), "176x120");
  EXPECT_EQ(refused([](References&, Pairs&) {}), "accepted");
  host.end();
}

}  // namespace
}  // namespace iclk::test
