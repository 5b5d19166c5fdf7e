#include <iclk/align/network/device_network.h>

namespace iclk::internal {
DeviceNetwork::DeviceNetwork(const engine::Context& context, const std::shared_ptr<const Model>& model, const Layout& layout,
                             const Plan& plan, int batch, engine::MemoryPlan& memory) {
  if (!model) return;
  encoder.emplace(context, model, layout, plan, static_cast<uint32_t>(batch + plan.max_references), memory);
  if (!model->m_estimator.empty()) m_estimator.emplace(context, model, layout, plan, batch, memory);
}

void DeviceNetwork::load(const std::shared_ptr<const engine::Context>& context, const engine::Workspace& memory,
                         uint32_t sum_lanes) {
  if (encoder) encoder->load(context, memory);
  if (m_estimator) m_estimator->load(context, memory, sum_lanes);
}

void DeviceNetwork::add_to(engine::ArenaSize& size) const {
  if (encoder) encoder->add_to(size, 2);
  if (m_estimator) m_estimator->add_to(size);
}

}  // namespace iclk::internal
