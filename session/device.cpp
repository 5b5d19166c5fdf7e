#include <iclk/session/device.h>

#include <cstdlib>
#include <utility>

namespace iclk {

std::shared_ptr<engine::Context> open_device(std::string wish) {
  if (wish.empty())
    if (const char* variable = std::getenv("ICLK_DEVICE")) wish = variable;
  engine::ContextOptions options;
  options.device = std::move(wish);
  return engine::create_context(options);
}

}  // namespace iclk
