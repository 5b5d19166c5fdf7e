#pragma once
#include <memory>
#include <optional>

#include <iclk/align/network/device_m_estimator.h>
#include <iclk/align/network/encoder.h>

namespace iclk::internal {

/// The parts of a model on a device; empty without a model.
struct DeviceNetwork {
  /// Arithmetic only: adds its buffers to `memory`. Precondition: check_model(), check_model_use().
  DeviceNetwork(const engine::Context& context, const std::shared_ptr<const Model>& model, const Layout& layout,
                const Plan& plan, int batch, engine::MemoryPlan& memory);

  /// Makes kernels and writes weights. Call it once, with a workspace of the plan. `sum_lanes`: WorkgroupSizes::iterate.
  void load(const std::shared_ptr<const engine::Context>& context, const engine::Workspace& memory, uint32_t sum_lanes);
  void add_to(engine::ArenaSize& size) const;

  std::optional<Encoder> encoder;
  std::optional<MEstimator> m_estimator;
};

}  // namespace iclk::internal
