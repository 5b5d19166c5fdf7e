#pragma once
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/engine/error.h>

#include "apps/iclk/batch/journal.h"
#include "apps/iclk/batch/pool.h"
#include "apps/iclk/batch/tally.h"

namespace iclk {

/// What `iclk batch` tells its caller besides the codes of command.h.
inline constexpr int kSomePairsFailed = 20;  ///< every line has a result, some with status "error"
inline constexpr int kStoppedBy = 128;       ///< plus the signal's number: 130 after Ctrl-C, 143 after SIGTERM

/// Turns pairs of one size and pixel type into result lines without a head: status, reason, ... Throws Error.
using AlignPairs = std::function<std::vector<nlohmann::ordered_json>(std::span<const PairInput>)>;

/// What a batch is made of.
struct BatchWork {
  std::vector<const ManifestLine*> lines;  ///< still to be done
  DecodePool::Measure measure;
  DecodePool::Decode decode;
  std::function<LineInputs(const ManifestLine&)> inputs;  ///< of a pair that `decode` threw for; may be empty
  AlignPairs align;
  std::function<bool()> stop;                                           ///< asked between batches
  std::function<void(const ManifestLine&, const std::string&)> failed;  ///< a pair got status "error"
  int batch = 1;
  PoolLimits limits;
};

struct BatchOutcome {
  int done = 0, failed = 0;
  bool stopped = false;
  double seconds = 0;
  std::optional<Error> lost;  ///< the device, or its memory: the pairs that remain are not marked as failed
};

/// Decodes, aligns, writes, until all is done, `stop` says so or the device is lost. A pair that fails gets its line with the
/// reason and the others go on: where a batch throws, its pairs are tried one by one. Throws Error(io) if a result cannot be
/// written.
BatchOutcome run_batch(const BatchWork& work, ResultsJournal& journal, Tally& tally,
                       const std::function<void(const BatchOutcome&)>& progress);

/// Whether an error says nothing about the pair, but would meet every later one too.
bool ends_the_run(ErrorCode code);

}  // namespace iclk
