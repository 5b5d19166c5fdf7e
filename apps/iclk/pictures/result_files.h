#pragma once
#include <string>

#include "apps/iclk/session/pair_input.h"
#include "apps/iclk/session/run_pairs.h"

namespace iclk {

/// Writes the pictures and, last of all, result.json into an existing folder, each file whole or not at all. Throws Error(io).
void write_results(const std::string& folder, const PairInput& pair, const RefinedAlignment& result, const Session& session);

/// The JSON contract as text, with a line end.
std::string json_text(const PairInput& pair, const RefinedAlignment& result, const Session& session);

}  // namespace iclk
