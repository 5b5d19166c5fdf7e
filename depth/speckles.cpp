#include <iclk/depth/internal/speckles.h>

#include <cmath>
#include <cstdint>
#include <vector>

namespace iclk::internal {

void drop_speckles(std::span<float> map, int width, int least, float step) {
  std::vector<uint8_t> visited(map.size(), 0);
  std::vector<size_t> island;
  const auto row = static_cast<size_t>(width);
  for (size_t seed = 0; seed < map.size(); ++seed) {
    if (visited[seed] || map[seed] == 0) continue;
    island.assign(1, seed);
    visited[seed] = 1;
    for (size_t i = 0; i < island.size(); ++i) {
      const size_t at = island[i], u = at % row;
      const auto reach = [&](bool there, size_t to) {
        if (!there || visited[to] || map[to] == 0 || std::abs(map[to] - map[at]) > step) return;
        visited[to] = 1;
        island.push_back(to);
      };
      reach(u > 0, at - 1);
      reach(u + 1 < row, at + 1);
      reach(at >= row, at - row);
      reach(at + row < map.size(), at + row);
    }
    if (island.size() < static_cast<size_t>(least))
      for (const size_t at : island) map[at] = 0;
  }
}

}  // namespace iclk::internal
