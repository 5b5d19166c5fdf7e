#include <iclk/depth/internal/buffers.h>

#include <algorithm>
#include <string>

#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

constexpr int kLeastAnswered = 16;

engine::MemoryBytes bytes_of(const engine::Context& context, const DepthPlan& plan, int rows) {
  engine::MemoryPlan layout;
  const DepthBuffers buffers(plan, rows, layout);
  const engine::MemoryBytes bytes = layout.bytes(context);
  if (plan.most_bytes > 0 && bytes.total() > plan.most_bytes)
    throw Error(ErrorCode::unsupported,
                "depth: images of " + std::to_string(plan.width) + "x" + std::to_string(plan.height) + " with " +
                    std::to_string(plan.planes) + " planes and " + std::to_string(plan.views) + " views, " +
                    std::to_string(rows) + " rows at a time, take " + std::to_string(bytes.total()) + " bytes, but " +
                    std::to_string(plan.most_bytes) + " are allowed; use fewer planes or smaller images");
  return bytes;
}

}  // namespace

DepthStrips strips_of(const engine::Context& context, const DepthPlan& plan) {
  for (int count = 1;; ++count) {
    const int answered = (plan.height + count - 1) / count;
    const int rows = count == 1 ? plan.height : std::min(plan.height, answered + 2 * DepthStrips::kOverlap);
    try {
      bytes_of(context, plan, rows);
      return {rows, answered};
    } catch (const Error& error) {
      if (error.code() != ErrorCode::unsupported || answered <= kLeastAnswered) throw;
    }
  }
}

DepthBuffers::DepthBuffers(const DepthPlan& p, int rows, engine::MemoryPlan& memory) {
  using engine::BufferUse;
  using engine::MemoryKind;
  const auto area = static_cast<uint64_t>(p.width) * static_cast<uint64_t>(p.height);
  const auto images = static_cast<uint64_t>(p.views) + 1;
  const uint64_t bytes = static_cast<uint64_t>(p.width) * static_cast<uint64_t>(rows) * static_cast<uint64_t>(p.planes);
  const auto texels = BufferUse::storage | BufferUse::texel;
  // Every device supports texel buffers of all four formats.
  constexpr VkFormat real = VK_FORMAT_R32_SFLOAT, four = VK_FORMAT_R32G32B32A32_SFLOAT, word = VK_FORMAT_R32_UINT,
                     quad = VK_FORMAT_R32G32B32A32_UINT;
  views = memory.add("depth views", sizeof(shaders::DepthViews), MemoryKind::table, BufferUse::uniform);
  grey = memory.add("depth images", 4 * area * images, MemoryKind::table, texels, real);
  priors = memory.add("depth priors", 4 * area, MemoryKind::table, texels, real);
  census = memory.add("census", 4 * area * images, MemoryKind::device, texels, word);
  costs = memory.add("costs", bytes, MemoryKind::device, texels, quad);
  for (engine::BufferId& path : paths) path = memory.add("path costs", bytes, MemoryKind::device, texels, quad);
  corners = memory.add("corners", 16 * area * images, MemoryKind::device, texels, four);
  winners = memory.add("winners", 8 * area, MemoryKind::device, BufferUse::storage);
  claims = memory.add("claims", 4 * area * (images - 1), MemoryKind::device, BufferUse::storage);
  raw_planes = memory.add("raw planes", 4 * area, MemoryKind::device, texels, real);
  planes = memory.add("planes", 4 * area, MemoryKind::device, texels, real);
  read_winners = memory.add("winners to read", 8 * area, MemoryKind::readback, BufferUse::transfer);
  read_planes = memory.add("planes to read", 4 * area, MemoryKind::readback, BufferUse::transfer);
}

}  // namespace iclk::internal
