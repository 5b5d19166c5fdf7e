// start() and finish(): align() in two halves, in the order that timeline semaphores of the application give.
#include <iclk/align/device_recording.h>
#include <iclk/engine/error.h>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

struct Scenes {
  Relief scene = moved_relief();
  Features features = random_features(scene, 50, 1);
  Frame image0 = render(scene, 0), image1 = render(scene, 1);
  Reference reference() const { return {image0.view(), scene.camera, features, {}}; }
  Pair pair() const { return {0, image1.view(), {}, {}}; }
};

template <class Call>
void expect_refused(const Call& call, const std::string& part) {
  try {
    call();
    ADD_FAILURE() << "not refused: " << part;
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
  }
}

TEST(Asynchronous, TwoHalvesAreTheWhole) {
  ICLK_NEED_DEVICE();
  const Scenes s;
  Plan plan = plan_for(s.scene.camera);
  plan.max_pairs = 3;
  DeviceAligner aligner(device(), plan, {}, Solver::device), whole(device(), plan, {}, Solver::device);
  EXPECT_TRUE(aligner.finish().empty());
  EXPECT_TRUE(aligner.finished());
  aligner.set_reference(0, s.reference());
  whole.set_reference(0, s.reference());
  const Pair pairs[] = {s.pair(), {0, s.image0.view(), {}, {}}};
  const std::vector<Alignment> expected = whole.align(pairs);
  ASSERT_TRUE(expected[0].converged()) << expected[0].reason;
  for (int round = 0; round < 2; ++round) {
    aligner.start(pairs);
    expect_refused([&] { aligner.start(pairs); }, "call finish() first");
    expect_refused([&] { aligner.align(s.pair()); }, "call finish() first");
    // What a slot holds while the device works on another thing does not reach the results.
    if (round == 1) aligner.set_reference(0, {s.image1.view(), s.scene.camera, random_features(s.scene, 7, 3), {}});
    while (!aligner.finished()) {
    }
    const std::vector<Alignment> found = aligner.finish();
    ASSERT_EQ(found.size(), 2u);
    for (size_t i = 0; i < 2; ++i) EXPECT_TRUE(same_bits(found[i], expected[i])) << found[i].reason;
    EXPECT_EQ(found[0].features.size(), 50u);
  }
}

TEST(Asynchronous, WhatItCannotStartIsRefused) {
  ICLK_NEED_DEVICE();
  const Scenes s;
  DeviceAligner host(device(), plan_for(s.scene.camera), {}, Solver::host);
  host.set_reference(0, s.reference());
  const Pair pair = s.pair();
  expect_refused([&] { host.start({&pair, 1}); }, "needs an aligner made with Solver::device");
  DeviceAligner aligner(device(), plan_for(s.scene.camera), {}, Solver::device);
  expect_refused([&] { aligner.start({&pair, 1}); }, "was never set");
  aligner.set_reference(0, s.reference());
  const Pair two[] = {pair, pair};
  expect_refused([&] { aligner.start(two); }, "2 pairs: start() takes 1 to 1");
  expect_refused([&] { aligner.start({}); }, "0 pairs");
  EXPECT_TRUE(aligner.align(pair).converged());  // nothing of that was left behind
}

TEST(Asynchronous, TheDeviceWaitsAndSignals) {
  ICLK_NEED_DEVICE();
  Application app;
  if (!app.timelines) GTEST_SKIP() << "no timeline semaphores";
  const auto context = app.adopt();
  const Timeline ready(app), done(app);
  const Scenes s;
  DeviceAligner aligner(context, plan_for(s.scene.camera), {}, Solver::device);
  aligner.set_reference(0, s.reference());
  const Alignment expected = aligner.align(s.pair());
  ASSERT_TRUE(expected.converged()) << expected.reason;

  const Pair pair = s.pair();
  const TimelinePoint begin{ready.handle, 3}, end{done.handle, 8};
  aligner.start({&pair, 1}, {.wait = {&begin, 1}, .signal = {&end, 1}});
  ready.signal(2);
  EXPECT_FALSE(done.wait(1, 200'000'000));  // it waits for 3
  EXPECT_FALSE(aligner.finished());
  ready.signal(3);
  EXPECT_TRUE(done.wait(8));
  EXPECT_TRUE(same_bits(aligner.finish().at(0), expected));

  // A recording in a submission of ours, and one submission behind the other without the host in between.
  const Scenes t;
  const BufferId image0{0}, image1{1};
  MemoryPlan memory_plan;
  memory_plan.add("image 0", 4 * t.image0.data.size(), MemoryKind::upload, BufferUse::transfer);
  memory_plan.add("image 1", 4 * t.image1.data.size(), MemoryKind::upload, BufferUse::transfer);
  const Workspace memory(context, memory_plan);
  std::copy(t.image0.data.begin(), t.image0.data.end(), memory[image0].as<float>());
  std::copy(t.image1.data.begin(), t.image1.data.end(), memory[image1].as<float>());
  const auto image = [&](BufferId id) { return DeviceBufferImage{memory[id].handle, memory[id].size, 0, 0}; };
  const auto recording = aligner.make_recording();
  Submission submission(context);
  const DeviceReference reference{0, image(image0), t.scene.camera, t.features};
  const DevicePair device_pair{0, image(image1), {}, {}};
  aligner.record(*recording, submission.begin(), {&reference, 1}, {&device_pair, 1});
  submission.end();
  const TimelinePoint next{ready.handle, 4}, last{done.handle, 9};
  submission.submit({.wait = {&next, 1}, .signal = {&last, 1}});
  EXPECT_FALSE(submission.finished());
  ready.signal(4);
  EXPECT_TRUE(done.wait(9));
  submission.wait();
  EXPECT_TRUE(submission.finished());
  EXPECT_TRUE(same_bits(recording->read().at(0), expected));
}

}  // namespace
}  // namespace iclk::test
