#include <iclk/session/device.h>

#include <algorithm>
#include <cstdlib>
#include <utility>

#include <iclk/engine/error.h>
#include <iclk/session/internal/pipeline_cache.h>

namespace iclk {
namespace {

// Drivers that cache no pipelines return only a header.
constexpr size_t kHeaderBytes = 32;

/// Returns a pointer whose last owner saves the compiled pipelines of the context, if they are more than `known` bytes.
std::shared_ptr<engine::Context> keeping_pipelines(std::shared_ptr<engine::Context> context, const std::string& file,
                                                   size_t known) {
  engine::Context* const given = context.get();
  return {given, [context = std::move(context), file, known](engine::Context*) mutable {
            try {
              const std::vector<uint8_t> data = context->pipeline_cache_data();
              if (data.size() > std::max(known, kHeaderBytes)) internal::write_pipelines(file, data);
            } catch (const Error&) {  // a full disk, a lost device: the next run compiles again
            }
            context.reset();
          }};
}

}  // namespace

std::shared_ptr<engine::Context> open_device(std::string wish) {
  if (wish.empty())
    if (const char* variable = std::getenv("ICLK_DEVICE")) wish = variable;
  engine::ContextOptions options;
  options.device = std::move(wish);
  std::string file;
  size_t known = 0;
  options.pipeline_cache = [&](const engine::DeviceInfo& device) {
    file = internal::pipeline_file(device);
    std::vector<uint8_t> kept = internal::read_pipelines(file);
    known = kept.size();
    return kept;
  };
  std::shared_ptr<engine::Context> context = engine::create_context(options);
  return file.empty() ? context : keeping_pipelines(std::move(context), file, known);
}

}  // namespace iclk
