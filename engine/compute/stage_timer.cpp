#include <iclk/engine/compute/stage_timer.h>

#include <algorithm>
#include <utility>

#include <iclk/engine/result.h>

namespace iclk::engine {

StageTimer::StageTimer(std::shared_ptr<const Context> context, uint32_t max_stages)
    : context_(std::move(context)), capacity_(max_stages + 1) {
  if (context_->timestamp_valid_bits() == 0) return;
  VkQueryPoolCreateInfo info{VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
  info.queryType = VK_QUERY_TYPE_TIMESTAMP;
  info.queryCount = capacity_;
  check(context_->vk().CreateQueryPool(context_->device(), &info, nullptr, &pool_), "vkCreateQueryPool",
        std::to_string(capacity_) + " timestamps");
}

StageTimer::~StageTimer() {
  if (pool_) context_->vk().DestroyQueryPool(context_->device(), pool_, nullptr);
}

void StageTimer::begin(VkCommandBuffer commands) {
  marks_.clear();
  if (pool_) context_->vk().CmdResetQueryPool(commands, pool_, 0, capacity_);
}

void StageTimer::mark(VkCommandBuffer commands, const char* name) {
  if (!pool_) return;
  if (marks_.size() == capacity_)
    throw Error(ErrorCode::invalid_argument,
                "StageTimer holds " + std::to_string(capacity_ - 1) + " stages; give it more max_stages");
  context_->vk().CmdWriteTimestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, pool_, static_cast<uint32_t>(marks_.size()));
  marks_.emplace_back(name ? name : "");
}

void StageTimer::collect() {
  if (marks_.size() < 2) return;
  std::vector<uint64_t> ticks(marks_.size());
  const VkResult result = context_->vk().GetQueryPoolResults(context_->device(), pool_, 0, static_cast<uint32_t>(ticks.size()),
                                                             ticks.size() * sizeof(uint64_t), ticks.data(), sizeof(uint64_t),
                                                             VK_QUERY_RESULT_64_BIT);
  check(result, "vkGetQueryPoolResults");
  if (result == VK_NOT_READY)
    throw Error(ErrorCode::invalid_argument, "StageTimer::collect() before the submission was waited for");
  const uint32_t bits = context_->timestamp_valid_bits();
  const uint64_t mask = bits >= 64 ? ~uint64_t{0} : (uint64_t{1} << bits) - 1;
  for (size_t i = 0; i + 1 < ticks.size(); ++i) {
    if (marks_[i].empty()) continue;
    auto time = std::find_if(times_.begin(), times_.end(), [&](const StageTime& t) { return t.name == marks_[i]; });
    if (time == times_.end()) time = times_.insert(times_.end(), StageTime{marks_[i]});
    const uint64_t elapsed = (ticks[i + 1] - ticks[i]) & mask;  // counters of few bits wrap
    time->milliseconds += static_cast<double>(elapsed) * context_->timestamp_period() * 1e-6;
    ++time->count;
  }
}

}  // namespace iclk::engine
