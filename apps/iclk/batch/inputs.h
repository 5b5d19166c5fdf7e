#pragma once
#include <map>
#include <string>

#include <nlohmann/json.hpp>

#include "apps/iclk/session/pair_input.h"
#include "apps/json/manifest.h"

namespace iclk {

/// What a pair is read from, as its result states it and as the next run finds it.
struct LineInputs {
  /// {"camera": [fx, fy, cx, cy, width, height], "distortion": "radtan:...", "depth_scale": 5000,
  ///  "reference": {"bytes": 1234, "modified": "2026-11-23T10:02:19.123456789Z"}, "target": ..., "depth": ..., ...}.
  /// A file that is not there is null; null as a whole: the line is too broken to say.
  nlohmann::ordered_json values;
  std::map<std::string, std::string> paths;  ///< of the files, by the keys of `values`
};

/// `options`: those of the line's camera.
LineInputs line_inputs(const PairRequest& request, const InputOptions& options);

/// The first thing in which the inputs differ, in words: "its target /a/b.png had 12 bytes and is of 2026-..., now it has ...".
/// Empty: none. A file that was there and is gone is no difference: the result is what is left of it.
std::string changed_input(const nlohmann::ordered_json& then, const LineInputs& now);

}  // namespace iclk
