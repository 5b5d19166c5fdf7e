#include "device_pose_cases.h"

#include <cmath>
#include <random>

#include <iclk/engine/submission.h>
#include <iclk/refine/internal/device_features.h>
#include <iclk/refine/internal/device_pose.h>
#include <iclk/refine/internal/reprojection.h>

#include "device.h"

namespace iclk::test {

std::vector<Outcome> run(const std::vector<Case>& cases, const RefinerOptions& options) {
  using engine::BufferUse;
  using engine::MemoryKind;
  const auto context = device();
  const size_t n = cases.size();
  int most = 1;
  for (const Case& c : cases) most = std::max(most, c.features.size());
  const auto stride = static_cast<size_t>(most);
  const internal::PoseBuffers ids(static_cast<int>(n), most, context->unified_memory());
  const engine::Workspace memory(context, ids.plan);
  engine::MemoryPlan more;
  const auto references = more.add("references", sizeof(shaders::ReferenceInfo) * n, MemoryKind::upload, BufferUse::storage);
  const auto iclk = more.add("results", sizeof(shaders::ResultInfo) * n, MemoryKind::upload, BufferUse::storage);
  const auto found = more.add("aligned", sizeof(shaders::AlignedInfo) * n * stride, MemoryKind::upload, BufferUse::transfer);
  const auto refined = more.add("refined", sizeof(shaders::RefinedInfo) * n, MemoryKind::readback, BufferUse::transfer);
  const auto states = more.add("states", sizeof(shaders::RefineState) * n, MemoryKind::readback, BufferUse::transfer);
  const auto tasks = more.add("tasks", sizeof(shaders::FeatureTask) * n, MemoryKind::readback, BufferUse::transfer);
  const engine::Workspace host(context, more);
  for (size_t i = 0; i < n; ++i) {
    const Case& c = cases[i];
    const auto first = static_cast<uint32_t>(i * stride), count = static_cast<uint32_t>(c.features.size());
    const auto checks = check_features(c.features, c.camera);
    for (size_t k = 0; k < count; ++k) {
      memory[ids.features].as<shaders::FeatureInfo>()[first + k] =
          internal::pack_feature(c.features, k, checks[k] == FeatureCheck::ok);
      const AlignedFeature& a = c.aligned[k];
      host[found].as<shaders::AlignedInfo>()[first + k] = {static_cast<float>(a.uv1.x()),
                                                           static_cast<float>(a.uv1.y()),
                                                           static_cast<float>(a.covariance(0, 0)),
                                                           static_cast<float>(a.covariance(0, 1)),
                                                           static_cast<float>(a.covariance(1, 1)),
                                                           1,
                                                           0,
                                                           1,
                                                           1,
                                                           static_cast<uint32_t>(a.status)};
    }
    const auto index = static_cast<uint32_t>(i);
    const auto unit = static_cast<float>(internal::unit_of(c.features));
    memory[ids.pairs].as<shaders::RefinePair>()[i] = {index, index, first, count, unit, c.search, 0};
    host[references].as<shaders::ReferenceInfo>()[i] = {static_cast<float>(c.camera.fx),
                                                        static_cast<float>(c.camera.fy),
                                                        static_cast<float>(c.camera.cx),
                                                        static_cast<float>(c.camera.cy),
                                                        static_cast<float>(internal::unit_of(c.features)),
                                                        0,
                                                        count};
    shaders::ResultInfo result{};
    pack_pose(c.T_10, result.pose);
    for (int k = 0; k < 36; ++k) result.covariance[k] = static_cast<float>(c.iclk_covariance(k / 6, k % 6));
    host[iclk].as<shaders::ResultInfo>()[i] = result;
  }
  const internal::DevicePose pose(context, options, cases[0].camera.width, cases[0].camera.height);
  engine::ArenaSize size;
  pose.add_to(size);
  engine::DescriptorArena arena(context, size);
  engine::Submission submission(context);
  engine::Recorder recorder(submission, arena);
  recorder.upload(memory[ids.pairs], 0, memory[ids.pairs].size);
  recorder.upload(memory[ids.features], 0, memory[ids.features].size);
  recorder.copy(host[found], memory[ids.aligned], sizeof(shaders::AlignedInfo) * n * stride);
  const auto count = static_cast<uint32_t>(n);
  pose.start(recorder, ids, memory, host[iclk], count);
  pose.round(recorder, ids, memory, host[references], count);
  recorder.copy(memory[ids.tasks], host[tasks], sizeof(shaders::FeatureTask) * n);
  pose.unbend(recorder, ids, memory, host[references], count);
  pose.verdict(recorder, ids, memory, host[references], count);
  recorder.copy(memory[ids.refined], host[refined], sizeof(shaders::RefinedInfo) * n);
  recorder.copy(memory[ids.states], host[states], sizeof(shaders::RefineState) * n);
  recorder.host_read({&host[refined], &host[states], &host[tasks]});
  recorder.finish();
  submission.end();
  submission.submit_and_wait();
  std::vector<Outcome> outcomes;
  for (size_t i = 0; i < n; ++i) {
    Outcome o{host[refined].as<shaders::RefinedInfo>()[i],
              host[states].as<shaders::RefineState>()[i],
              host[tasks].as<shaders::FeatureTask>()[i],
              {},
              Matrix6d::Zero()};
    o.T_10 = unpack_pose(o.info.pose);
    for (int k = 0; k < 36; ++k) o.covariance(k / 6, k % 6) = o.info.covariance[k];
    outcomes.push_back(o);
  }
  return outcomes;
}

Case case_of(const Scene& scene, int count, double sigma, double outliers, uint32_t seed, double depth_error) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  Case c{scene.camera, random_features(scene, count, seed), {}, {}};
  c.aligned = correspondences(scene, c.features, sigma, random, outliers);
  for (AlignedFeature& a : c.aligned) a.covariance << 0.01, 0.002, 0.002, 0.004;
  for (double& q : c.features.inverse_depth) q *= 1 + depth_error * normal(random);
  Vector6d start;
  start << 0.3, -0.3, 0.2, 0.004, -0.004, 0.01;
  c.T_10 = scene.T_10 * SE3::exp(start);
  return c;
}

double motion(const Case& c, const SE3& a, const SE3& b) {
  double most = 0;
  for (size_t i = 0; i < c.features.uv.size(); ++i) {
    if (!c.features.uv[i].allFinite()) continue;
    const Eigen::Vector3d X = c.camera.ray(c.features.uv[i]) / c.features.inverse_depth[i];
    most = std::max(most, (c.camera.project(a * X) - c.camera.project(b * X)).norm());
  }
  return most;
}

}  // namespace iclk::test
