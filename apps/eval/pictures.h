#pragma once
#include <vector>

#include "apps/eval/run.h"
#include "apps/iclk/pictures/pictures.h"

namespace iclk {

/// - errors.png: share of pairs within an error, by stage and by method; a row an appearance, where there are at most three
/// - basin.png: success against the start's error in px, depth units and degrees
/// - strengths.png: with a sweep, success against the strength of each change
/// - stages.png: one pair, stage by stage: features with lines to their true positions above, overlays below
/// - changes.png: with changes, what they do to the image they are applied to
std::vector<Picture> make_eval_pictures(const EvalReport& report);

}  // namespace iclk
