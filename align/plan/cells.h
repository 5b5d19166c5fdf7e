#pragma once
#include <cstdint>

#include <iclk/align/options.h>

namespace iclk::internal {

/// The lattice of at most Plan::max_features nearly square cells; shaders/align/choose.comp chooses one feature in each. They
/// keep a distance from the image border. Images that are too small have none.
struct Cells {
  explicit Cells(const Plan& plan);

  uint32_t border = 0, width = 0, height = 0;  ///< of all cells together, pixels
  uint32_t columns = 0, rows = 0;

  uint32_t count() const { return columns * rows; }
  /// Pixels [u0, u1) x [v0, v1).
  struct Rectangle {
    uint32_t u0, u1, v0, v1;
  };
  Rectangle operator[](uint32_t index) const;
};

}  // namespace iclk::internal
