#pragma once
#include <chrono>
#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <set>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "apps/iclk/session/pair_input.h"
#include "apps/json/manifest.h"

namespace iclk {

/// A line of the manifest, decoded; or why it cannot be.
struct DecodedPair {
  const ManifestLine* line = nullptr;
  PairInput pair;
  nlohmann::ordered_json meta, inputs;  ///< `inputs`: LineInputs::values
  std::string error;                    ///< empty: `pair` is complete
  size_t bytes = 0;                     ///< of its pixels; the pool's
};

/// Pairs for one batch: all failed, or all of one image size and pixel type.
struct PairGroup {
  std::vector<DecodedPair> items;  ///< in the manifest's order
};

struct PoolLimits {
  int threads = 1;
  int pairs = 2;                   ///< in memory at a time: being decoded, waiting, and in the group handed out
  size_t bytes = size_t{1} << 30;  ///< of pixels, those being decoded included; only a pair alone may be more
};

/// Decodes lines in the manifest's order, some ahead of who takes them. A bounded number of pairs is in memory.
class DecodePool {
 public:
  using Decode = std::function<DecodedPair(const ManifestLine&)>;
  using Measure = std::function<size_t(const ManifestLine&)>;
  /// Both are called from many threads; what they throw becomes the pair's error. `measure` says how many bytes `decode` will
  /// take; they are set aside before it is called. `lines` must outlive the pool.
  DecodePool(
      std::span<const ManifestLine* const> lines, Decode decode, const PoolLimits& limits,
      Measure measure = [](const ManifestLine&) { return size_t{0}; });
  ~DecodePool();

  /// Takes back `group` (whoever moved its pixels elsewhere has dropped them) and fills it with the next pairs, at most
  /// `count`: as soon as `count` of the first one's kind are there, or fewer where no more can come before some are taken.
  /// Failed pairs come at once. Empty if nothing came within `patience`, or at the end.
  void next(PairGroup& group, int count, std::chrono::milliseconds patience);
  /// Every pair was handed out.
  bool finished() const;
  /// Nothing is begun any more; waits for what is being decoded.
  void stop();

 private:
  void work();
  DecodedPair decode(const ManifestLine& line, size_t& reserved);
  bool may_begin() const;  // with mutex_ held, like those below
  bool fits(size_t bytes) const { return bytes_ == 0 || bytes_ + bytes <= limits_.bytes; }
  bool done() const;
  bool fill(PairGroup& group, int count);
  void free(PairGroup& group);

  std::span<const ManifestLine* const> lines_;
  Measure measure_;
  Decode decode_;
  PoolLimits limits_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::map<size_t, DecodedPair> ready_;
  size_t next_ = 0;  // line to begin
  int decoding_ = 0;
  int held_ = 0;                   // pairs in memory
  size_t bytes_ = 0;               // set aside for pairs being decoded, or theirs
  std::multiset<size_t> waiting_;  // what decoding takes that does not fit yet
  bool stopped_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace iclk
