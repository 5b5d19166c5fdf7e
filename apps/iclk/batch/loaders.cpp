#include "apps/iclk/batch/loaders.h"

#include <iclk/engine/error.h>

namespace iclk {
namespace {

/// Loaders hold undistortion maps, 9 bytes a pixel: not one for each of a million cameras.
constexpr size_t kMaxLoaders = 16;

}  // namespace

LoaderCache::LoaderCache(const LoadOptions& defaults) : defaults_(defaults) {
  LoadOptions checked = defaults;
  if (checked.camera.empty()) checked.camera = "1,1,0,0";  // every line brings its own
  const PairLoader ignored(checked.input());
}

std::shared_ptr<const PairLoader> LoaderCache::loader(const PairRequest& request) const {
  LoadOptions options = defaults_;
  if (request.camera) options.camera = *request.camera;
  if (request.distortion) options.distortion = *request.distortion;
  if (request.depth_scale) options.depth_scale = *request.depth_scale;
  if (options.camera.empty())
    throw Error(ErrorCode::invalid_argument, "key 'camera' is missing; add it to the line, or give --camera");
  const std::string key = options.camera + '\n' + options.distortion + '\n' + nlohmann::json(options.depth_scale).dump();
  {
    const std::lock_guard lock(mutex_);
    if (const auto found = loaders_.find(key); found != loaders_.end()) return found->second;
  }
  auto loader = std::make_shared<const PairLoader>(options.input());
  const std::lock_guard lock(mutex_);
  if (loaders_.size() >= kMaxLoaders) loaders_.clear();
  return loaders_.emplace(key, std::move(loader)).first->second;
}

LineInputs LoaderCache::inputs(const Manifest& manifest, const ManifestLine& line) const {
  try {
    const PairRequest request = parse_line(manifest, line);
    return line_inputs(request, loader(request)->options());
  } catch (const Error&) {
    return {};  // load() says why
  }
}

uint64_t LoaderCache::memory(const Manifest& manifest, const ManifestLine& line, uint64_t budget) const {
  const PairRequest request = parse_line(manifest, line);
  try {
    return loader(request)->memory(request.files, budget);
  } catch (const Error& e) {
    throw Error(e.code(), place(manifest, line) + ": " + e.what());
  }
}

DecodedPair LoaderCache::load(const Manifest& manifest, const ManifestLine& line) const {
  const PairRequest request = parse_line(manifest, line);
  DecodedPair item;
  try {
    const auto loader = this->loader(request);
    item.inputs = line_inputs(request, loader->options()).values;  // before they are read: a later change is seen as one
    item.pair = loader->load(request.files);
  } catch (const Error& e) {
    throw Error(e.code(), place(manifest, line) + ": " + e.what());
  }
  item.pair.T_10 = request.T_10;
  item.pair.truth = request.truth;
  item.meta = request.meta;
  return item;
}

}  // namespace iclk
