#pragma once
#include <string>

#include "apps/eval/run.h"

namespace iclk {

/// `pair` after the changes of one variant.
PairInput change_pair(const PairInput& pair, const AppearanceSpec& appearance, const EvalOptions& options,
                      const std::string& id, int variant);

/// What a pair is called where every variant of every appearance has a line of its own: "000007" while it is clean, else
/// "000007@jitter:0.8#2". Results of other programs name pairs so (foreign_poses.h).
std::string exported_id(const std::string& id, const AppearanceSpec& appearance, int variant);

/// Writes what run_eval would align, for other programs: pairs.jsonl (a manifest of `iclk batch`, written last), images as
/// PNG, depth as 32-bit float TIFF, features as CSV. Images are undistorted as ours are, so that everybody sees the same
/// pixels. Throws Error as run_eval does; Error(unsupported) for images of 32-bit floats; Error(io) for what cannot be written.
void export_eval(const Manifest& manifest, const EvalLoader& loader, const EvalOptions& options, const std::string& folder,
                 const EvalProgress& progress);

}  // namespace iclk
