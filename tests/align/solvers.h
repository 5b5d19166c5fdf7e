#pragma once
#include <memory>
#include <ostream>
#include <string>

#include <gtest/gtest.h>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device_aligner.h>

#include "device.h"
#include "relief.h"

namespace iclk::test {

/// Every way to solve. `split` is the device solver on levels too large for one workgroup (normal_equations.comp and
/// lm_step.comp in place of iterate.comp): a plan for more features than it gets is enough to take it.
enum class Way { cpu, host, device, split };
constexpr int kSplitFeatures = 600;  // more than WorkgroupSizes::fused_elements / 64 of any device type

inline const char* name(Way way) {
  constexpr const char* names[] = {"cpu", "host", "device", "split"};
  return names[static_cast<int>(way)];
}

/// What ctest shows as the parameter's value.
inline void PrintTo(Way way, std::ostream* out) { *out << name(way); }

/// A scene whose second view differs in every direction of the pose, by a few pixels.
inline Relief moved_relief() {
  Relief scene;
  Vector6d xi;
  xi << 0.05, -0.06, 0.1, 0.01, 0.012, -0.02;
  scene.T_10 = SE3::exp(xi);
  return scene;
}

/// r32f: nothing is lost on the way to the device.
inline Plan plan_for(const Camera& camera, int max_features = 50) {
  Plan plan{camera.width, camera.height};
  plan.max_features = max_features;
  plan.format = PixelFormat::r32f;
  return plan;
}

inline std::unique_ptr<Aligner> make_aligner(Way way, Plan plan, const AlignerOptions& options = {}) {
  if (way == Way::cpu) return make_cpu_aligner(plan, options);
  if (way == Way::split) plan.max_features = std::max(plan.max_features, kSplitFeatures);
  return make_device_aligner(device(), plan, options, way == Way::host ? Solver::host : Solver::device);
}

/// One pair with 50 features, prepared and aligned.
inline Alignment align_once(Way way, const Relief& scene, const Frame& image0, const Frame& image1, const Features& features,
                            const AlignerOptions& options = {}, const SE3& start = {},
                            const std::optional<PosePrior>& prior = {}) {
  const auto aligner = make_aligner(way, plan_for(scene.camera, features.size()), options);
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  return aligner->align(Pair{0, image1.view(), start, prior});
}

/// |Log(a^-1 b)|, translation divided by `unit`.
inline double distance(const SE3& a, const SE3& b, double unit) {
  Vector6d xi = (a.inverse() * b).log();
  xi.head<3>() /= unit;
  return xi.norm();
}

inline bool same_bits(const Alignment& a, const Alignment& b) {
  return a.T_10.R == b.T_10.R && a.T_10.t == b.T_10.t && a.H == b.H && a.covariance == b.covariance && a.cost == b.cost &&
         a.gain == b.gain && a.bias == b.bias && a.correlation == b.correlation && a.status == b.status && a.reason == b.reason;
}

/// Tests over all ways; without a device only the CPU reference's run.
class Solvers : public testing::TestWithParam<Way> {
 protected:
  void SetUp() override {
    if (GetParam() != Way::cpu) ICLK_NEED_DEVICE();
  }
  Way way() const { return GetParam(); }
};

inline std::string way_name(const testing::TestParamInfo<Way>& info) { return name(info.param); }

}  // namespace iclk::test
