#pragma once
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iclk/session/session.h>

#include "apps/iclk/session/pair_input.h"

namespace iclk {

/// One result a pair, in order. Throws as Session::align() does; names the first pair, and an option, where the session cannot
/// be made for such images.
std::vector<RefinedAlignment> run_pairs(Session& session, std::span<const PairInput> pairs);
inline RefinedAlignment run_pair(Session& session, const PairInput& pair) {
  return std::move(run_pairs(session, std::span(&pair, 1)).front());
}

/// The times of the last run as lines of text; with those of the device's stages where the session keeps them.
std::string profile_text(const Session& session, const PairInput& pair);

}  // namespace iclk
