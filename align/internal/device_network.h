#pragma once
#include <memory>
#include <optional>

#include <iclk/align/internal/encoder.h>
#include <iclk/align/internal/device_m_estimator.h>

namespace iclk::internal {

/// Throws Error(invalid_argument) unless the model's layers fit each other and it has the levels that the options ask for.
void check_model(const Model& model, const AlignerOptions& options);

/// What a device computes of a model; nothing where there is none.
struct DeviceNetwork {
  /// Arithmetic only: adds its buffers to `memory`. Precondition: check_model().
  DeviceNetwork(const engine::Context& context, const std::shared_ptr<const Model>& model, const Layout& layout,
                const Plan& plan, int batch, const Tuning& tuning, engine::MemoryPlan& memory);

  /// Kernels and weights. Once, with a workspace of that plan.
  void load(const std::shared_ptr<const engine::Context>& context, const engine::Workspace& memory);
  void add_to(engine::ArenaSize& size) const;

  std::optional<Encoder> encoder;
  std::optional<MEstimator> m_estimator;
};

}  // namespace iclk::internal
