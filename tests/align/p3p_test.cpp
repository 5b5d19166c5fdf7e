// The minimal solver in single precision, as shaders/search/hypothesise.comp runs it, on triples of its own: in a whole start a
// wrong coefficient hides behind hundreds of other tries and the refinement.
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include <iclk/align/search/p3p.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/submission.h>

#include "device.h"
#include "p3p.comp.spv.h"

namespace iclk::test {
namespace {

using namespace engine;
using Eigen::Vector3d;

struct Triple {
  std::array<Vector3d, 3> points, rays;
  SE3 truth;
};

struct Solutions {
  std::vector<SE3> poses;
};

struct Push {
  uint32_t count;
};

std::vector<Solutions> solve_on_device(const std::vector<Triple>& triples) {
  MemoryPlan plan;
  const auto count = static_cast<uint32_t>(triples.size());
  const BufferId in = plan.add("triples", 96ull * count, MemoryKind::upload, BufferUse::storage),
                 out = plan.add("poses", 208ull * count, MemoryKind::readback, BufferUse::storage);
  const Workspace memory(device(), plan);
  float* to = memory[in].as<float>();
  for (const Triple& t : triples)
    for (const auto* three : {&t.points, &t.rays})
      for (const Vector3d& x : *three) {
        for (int i = 0; i < 3; ++i) *to++ = static_cast<float>(x(i));
        *to++ = 0;
      }
  const Kernel kernel(device(), {.name = "p3p",
                                 .spirv = p3p_comp_spv,
                                 .bindings = {BindingKind::storage_read, BindingKind::storage_write},
                                 .push_constant_bytes = sizeof(Push),
                                 .specialization = {64}});
  DescriptorArena arena(device(), {.sets = 1, .storage = 2, .texel = 1, .uniform = 1});
  Submission submission(device());
  Recorder recorder(submission, arena);
  recorder.dispatch(kernel, {&memory[in], &memory[out]}, Push{count}, {groups_for(count, 64)});
  recorder.host_read({&memory[out]});
  submission.end();
  submission.submit_and_wait();
  std::vector<Solutions> all;
  const float* from = memory[out].as<float>();
  for (uint32_t n = 0; n < count; ++n, from += 52) {
    Solutions s;
    for (int k = 0; k < static_cast<int>(from[0]) && k < 4; ++k) {
      SE3 T;
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 4; ++c) (c < 3 ? T.R(r, c) : T.t(r)) = from[4 + 12 * k + 4 * r + c];
      s.poses.push_back(T);
    }
    all.push_back(s);
  }
  return all;
}

std::vector<Triple> random_triples(int count) {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> x(-1, 1);
  std::vector<Triple> triples;
  while (static_cast<int>(triples.size()) < count) {
    Triple t;
    Vector6d xi;
    for (int i = 0; i < 6; ++i) xi(i) = 0.5 * x(random);
    t.truth = SE3::exp(xi);
    for (size_t i = 0; i < 3; ++i) {
      t.points[i] = t.truth.inverse() * Vector3d(0.6 * x(random), 0.4 * x(random), 1 + 0.4 * x(random));
      t.rays[i] = (t.truth * t.points[i]).normalized();
    }
    // As wide as triples of features are: where they are nearly on one line, single precision has nothing to say.
    const Vector3d a = t.points[1] - t.points[0], b = t.points[2] - t.points[0];
    if (a.cross(b).norm() > 0.05) triples.push_back(t);
  }
  return triples;
}

double apart(const SE3& a, const SE3& b) { return (a.R - b.R).norm() + (a.t - b.t).norm(); }

TEST(DeviceP3P, FindsTheTruthAndWhatTheCpuFinds) {
  ICLK_NEED_DEVICE();
  const std::vector<Triple> triples = random_triples(1000);
  const std::vector<Solutions> all = solve_on_device(triples);
  int found = 0, explains = 0, solutions = 0, wanted = 0, shared = 0;
  for (size_t n = 0; n < triples.size(); ++n) {
    const Triple& t = triples[n];
    bool near = false;
    for (const SE3& T : all[n].poses) {
      ++solutions;
      double off = 0;
      for (size_t i = 0; i < 3; ++i) off = std::max(off, ((T * t.points[i]).normalized() - t.rays[i]).norm());
      explains += off < 1e-3;  // half a pixel of 500
      near = near || apart(T, t.truth) < 1e-2;
    }
    found += near;
    for (const SE3& T : internal::p3p(t.points, t.rays)) {
      ++wanted;
      for (const SE3& mine : all[n].poses)
        if (apart(T, mine) < 1e-2) {
          ++shared;
          break;
        }
    }
  }
  EXPECT_GE(found, 970);
  EXPECT_GE(explains, 0.97 * solutions);
  EXPECT_GE(shared, 0.97 * wanted);
}

TEST(DeviceP3P, DegenerateTriplesHarmNobody) {
  ICLK_NEED_DEVICE();
  std::vector<Triple> triples = random_triples(64);
  const Vector3d a = triples[0].points[0];
  triples[1].points = {a, a, a};
  triples[2].points = {a, a * 1.1, a * 1.2};  // on one line
  triples[3].rays[2] = triples[3].rays[0];
  triples[4].points[0].setConstant(NAN);
  triples[5].rays[1].setZero();
  const std::vector<Solutions> all = solve_on_device(triples), alone = solve_on_device(random_triples(64));
  for (size_t n = 0; n < triples.size(); ++n) {
    EXPECT_LE(all[n].poses.size(), 4u);
    if (n > 0 && n < 6) continue;
    ASSERT_EQ(all[n].poses.size(), alone[n].poses.size());
    for (size_t k = 0; k < all[n].poses.size(); ++k) EXPECT_EQ(all[n].poses[k].matrix(), alone[n].poses[k].matrix());
  }
}

}  // namespace
}  // namespace iclk::test
