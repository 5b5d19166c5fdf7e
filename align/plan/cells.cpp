#include <iclk/align/plan/cells.h>

#include <algorithm>
#include <cmath>

#include <iclk/shaders/shared.h>

namespace iclk::internal {

Cells::Cells(const Plan& plan) {
  const int shorter = std::min(plan.width, plan.height);
  border = static_cast<uint32_t>(std::clamp(shorter / 4, ICLK_PATCH / 2 + 1, ICLK_PATCH));
  const int inside_u = plan.width - 2 * static_cast<int>(border), inside_v = plan.height - 2 * static_cast<int>(border);
  if (inside_u <= 0 || inside_v <= 0) return;
  width = static_cast<uint32_t>(inside_u);
  height = static_cast<uint32_t>(inside_v);
  const auto most = static_cast<uint32_t>(plan.max_features);
  const double square = std::sqrt(static_cast<double>(most) * width / height);
  columns = std::clamp(static_cast<uint32_t>(std::lround(square)), 1u, std::min(most, width));
  rows = std::clamp(most / columns, 1u, height);
}

Cells::Rectangle Cells::operator[](uint32_t index) const {
  const uint32_t column = index % columns, row = index / columns;
  return {border + width * column / columns, border + width * (column + 1) / columns, border + height * row / rows,
          border + height * (row + 1) / rows};
}

}  // namespace iclk::internal
