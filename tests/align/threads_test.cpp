// Several threads: aligners that share a context, and an application that submits to the same queue.
#include <atomic>
#include <mutex>
#include <thread>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

Relief moved(double t, uint32_t seed) {
  Relief scene;
  scene.seed = seed;
  scene.T_10.t = {t, -0.5 * t, t};
  return scene;
}

struct Job {
  Relief scene;
  Solver solver;
  Frame reference, target;
  Features features;
  Alignment expected;

  Alignment run(const std::shared_ptr<Context>& context) const {
    DeviceAligner aligner(context, plan_for(scene.camera), {}, solver);
    aligner.set_reference(0, {reference.view(), scene.camera, features, {}});
    return aligner.align({.target = target.view()});
  }
};

TEST(Threads, AlignersShareAContextAndTheApplicationsQueue) {
  ICLK_NEED_DEVICE();
  Application app;
  HostDevice host = app.handed_over();
  std::mutex queue;
  host.lock_queue = [&] { queue.lock(); };
  host.unlock_queue = [&] { queue.unlock(); };
  const auto context = adopt_device(host);
  std::vector<Job> jobs;
  for (const uint32_t seed : {1u, 2u, 3u}) {
    const Relief scene = moved(0.02 * seed, seed);
    jobs.push_back({scene,
                    seed == 2 ? Solver::host : Solver::device,
                    render(scene, 0),
                    render(scene, 1),
                    random_features(scene, 40, seed),
                    {}});
    jobs.back().expected = jobs.back().run(context);
    ASSERT_TRUE(jobs.back().expected.converged()) << jobs.back().expected.reason;
  }

  std::atomic<bool> done = false;
  std::atomic<int> submitted = 0, different = 0;
  std::thread application([&] {
    while (!done) {
      const ApplicationCommands commands(app);
      commands.end();
      const std::lock_guard lock(queue);
      commands.submit_and_wait();
      ++submitted;
    }
  });
  std::vector<std::thread> threads;
  for (const Job& job : jobs)
    threads.emplace_back([&] {
      for (int round = 0; round < 2; ++round) different += !same_bits(job.run(context), job.expected);
    });
  for (std::thread& thread : threads) thread.join();
  done = true;
  application.join();
  EXPECT_EQ(different, 0);
  EXPECT_GT(submitted, 0);
}

}  // namespace
}  // namespace iclk::test
