#include <algorithm>
#include <array>
#include <vector>

#include <iclk/depth/depth_sweep.h>

namespace iclk {

void fill(DepthMap& map) {
  constexpr int kWays[8][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, 1}, {1, -1}, {-1, -1}};
  const Map given = map.inverse_depth;
  const int width = given.width, height = given.height;
  // One direction after the other: each pixel takes over the value of the previous one.
  std::array<std::vector<float>, 2> least;
  for (auto& list : least) list.assign(given.data.size(), 0.0f);
  std::vector<float> seen(given.data.size());
  for (const auto& way : kWays) {
    const int du = way[0], dv = way[1];
    for (int j = 0; j < height; ++j)
      for (int i = 0; i < width; ++i) {
        const int u = du > 0 ? width - 1 - i : i, v = dv > 0 ? height - 1 - j : j;
        const size_t at = static_cast<size_t>(v) * static_cast<size_t>(width) + static_cast<size_t>(u);
        const int a = u + du, b = v + dv;
        const bool inside = a >= 0 && b >= 0 && a < width && b < height;
        const float w = given.data[at] > 0 ? given.data[at]
                        : inside           ? seen[static_cast<size_t>(b) * static_cast<size_t>(width) + static_cast<size_t>(a)]
                                           : 0.0f;
        seen[at] = w;
        if (!(w > 0)) continue;
        if (!(least[0][at] > 0) || w < least[0][at]) {
          least[1][at] = least[0][at];
          least[0][at] = w;
        } else if (!(least[1][at] > 0) || w < least[1][at]) {
          least[1][at] = w;
        }
      }
  }
  for (size_t at = 0; at < given.data.size(); ++at)
    if (!(given.data[at] > 0)) map.inverse_depth.data[at] = least[1][at] > 0 ? least[1][at] : least[0][at];
}

}  // namespace iclk
