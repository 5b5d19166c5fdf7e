// What marks.comp and its C++ share.
#ifdef __cplusplus
#include <cstdint>
namespace embed {
using uint = uint32_t;
#endif

#define EMBED_CONVERGED 0u  // iclk::Status::converged

struct MarksPush {
  float fx, fy, cx, cy;
  float true_pose[12];  // T_10, 3x4 row-major: only for the rings
  uint target;          // 0: the reference, which gets its features and nothing else
  uint thickness;       // px
};

#ifdef __cplusplus
}  // namespace embed
#endif
