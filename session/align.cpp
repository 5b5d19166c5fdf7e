#include <iclk/session/align.h>

namespace iclk {

Answer align(const ImageView& reference, const ImageView& depth, const ImageView& target, const Camera& camera,
             const SessionOptions& options, const std::optional<SE3>& T_10) {
  return Session(options).align(reference, depth, target, camera, T_10);
}

Answer align(const Reference& reference, const ImageView& target, const SessionOptions& options,
             const std::optional<SE3>& T_10) {
  return Session(options).align(reference, target, T_10);
}

}  // namespace iclk
