#pragma once
#include <optional>
#include <string>
#include <vector>

#include <iclk/render/geotiff.h>

#include "apps/iclk/locate/frames.h"
#include "apps/iclk/locate/run.h"

namespace iclk {

/// Those frames that have a prior, with it, and in a sequence all frames after the first that has one; `left_out` gets the
/// others, each with the reason. `camera`: gets the calibration
/// that the pictures state if it is empty. Throws Error(invalid_argument) if no frame has a prior or no camera is known, and
/// the errors of load_priors().
std::vector<LocateFrame> with_priors(const std::vector<LocateFrame>& frames, const LocateRun& run, const MapSystem& map,
                                     std::optional<CameraFile>& camera, std::vector<std::string>& left_out);

/// Throws Error(invalid_argument) unless the map lies where some prior looks from.
void check_places(const std::vector<LocateFrame>& frames, const GeoMap& map, const LocateRun& run);

/// Heights of priors become those of the map, as `run.priors` says. Leaves out frames below which the map has no ground, if it
/// is needed. Throws Error(invalid_argument) if no frame is left.
void count_heights_as_map(std::vector<LocateFrame>& frames, const GeoMap& map, const LocateRun& run,
                          std::vector<std::string>& left_out);

}  // namespace iclk
