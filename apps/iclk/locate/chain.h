#pragma once
#include "apps/iclk/locate/frames.h"
#include "apps/iclk/locate/journal.h"
#include "apps/iclk/locate/run.h"

namespace iclk {

/// Locates frames that follow each other (`iclk locate --sequence`). The journal gets a line per frame with its live pose, and
/// at the end the poses that follow from all frames. Throws the errors of SequenceLocator.
void locate_sequence(const LocateRun& run, const std::vector<LocateFrame>& frames, LocateFrames& pictures,
                     const MapSystem& system, Locator& locator, LocatedJournal& journal,
                     const std::function<void(const ProgressState&)>& progress, LocateReport& report);

}  // namespace iclk
