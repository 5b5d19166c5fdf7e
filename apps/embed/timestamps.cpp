#include "apps/embed/timestamps.h"

#include <iclk/engine/result.h>

namespace embed {

Timestamps::Timestamps(Host& host, uint32_t stamps) : host_(host), capacity_(stamps) {
  if (host.ns_per_tick == 0) return;
  VkQueryPoolCreateInfo info{VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
  info.queryType = VK_QUERY_TYPE_TIMESTAMP;
  info.queryCount = stamps;
  iclk::engine::check(vkCreateQueryPool(host.device, &info, nullptr, &pool_), "vkCreateQueryPool");
}

Timestamps::~Timestamps() { vkDestroyQueryPool(host_.device, pool_, nullptr); }

void Timestamps::record_start(VkCommandBuffer commands) {
  used_ = 0;
  if (pool_) vkCmdResetQueryPool(commands, pool_, 0, capacity_);
  record(commands);
}

void Timestamps::record(VkCommandBuffer commands) {
  if (pool_ && used_ < capacity_) vkCmdWriteTimestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, pool_, used_++);
}

std::vector<double> Timestamps::read() const {
  std::vector<double> parts;
  if (used_ < 2) return parts;
  std::vector<uint64_t> ticks(used_);
  iclk::engine::check(vkGetQueryPoolResults(host_.device, pool_, 0, used_, used_ * sizeof(uint64_t), ticks.data(),
                                            sizeof(uint64_t), VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT),
                      "vkGetQueryPoolResults");
  for (size_t i = 1; i < ticks.size(); ++i)
    parts.push_back(static_cast<double>(ticks[i] - ticks[i - 1]) * host_.ns_per_tick * 1e-6);
  return parts;
}

}  // namespace embed
