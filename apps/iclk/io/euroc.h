#pragma once
#include <optional>
#include <string>

#include "apps/iclk/io/sequence.h"

namespace iclk {

/// The folder that holds cam0/data.csv: the recording itself or its mav0. Nothing where it is no EuRoC ASL recording.
std::optional<std::string> euroc_root(const std::string& folder);

/// A stereo recording in EuRoC's ASL layout: cam0/ and cam1/ with data.csv, data/ and sensor.yaml, and where it exists
/// state_groundtruth_estimate0/data.csv. Frames that both cameras have within a millisecond. SequenceFrame::right is the
/// right image; the truth is that of the left camera. Throws as load_sequence().
Sequence load_euroc_sequence(const std::string& root);

}  // namespace iclk
