#include <iclk/align/alignment.h>

#include <array>

namespace iclk {

const char* name(Status status) {
  constexpr std::array<const char*, 7> names = {"converged",        "max_iterations", "low_overlap", "degenerate",
                                                "too_few_features", "diverged",       "ambiguous"};
  return names[static_cast<size_t>(status)];
}

}  // namespace iclk
