#pragma once
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "apps/iclk/batch/inputs.h"
#include "apps/iclk/batch/pool.h"
#include "apps/iclk/session/run_options.h"

namespace iclk {

/// One PairLoader a camera, so that a camera file is read and its undistortion computed once and not once a pair. Thread-safe.
class LoaderCache {
 public:
  /// Throws Error that names a bad default, --camera included.
  explicit LoaderCache(const LoadOptions& defaults);

  /// Reads what a line asks for. Throws Error "<manifest>:<line>: ...".
  DecodedPair load(const Manifest& manifest, const ManifestLine& line) const;
  /// PairLoader::memory() of a line. Throws Error "<manifest>:<line>: ...".
  uint64_t memory(const Manifest& manifest, const ManifestLine& line, uint64_t budget) const;
  /// What a line is read from, as it is now. Never throws for what the line or a file lacks.
  LineInputs inputs(const Manifest& manifest, const ManifestLine& line) const;
  /// What loads the pairs of a line's camera.
  std::shared_ptr<const PairLoader> loader(const PairRequest& request) const;

 private:
  LoadOptions defaults_;
  mutable std::mutex mutex_;
  mutable std::map<std::string, std::shared_ptr<const PairLoader>> loaders_;
};

}  // namespace iclk
