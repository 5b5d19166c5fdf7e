#pragma once
#include <string>

#include <nlohmann/json.hpp>

#include <iclk/refine/refiner.h>
#include <iclk/session/pose_errors.h>

#include "apps/iclk/session/pair_input.h"
#include "apps/iclk/session/run_pairs.h"

namespace iclk {

/// The name of the JSON contract, with its number: docs/schema/result-1.json. A key may be added; where one goes or means
/// something else, the number is another one.
inline constexpr const char* kResultSchema = "iclk-result-1";

/// The JSON contract of `iclk align` and of a line of `iclk batch`:
///
///   schema, version      kResultSchema and iclk's version
///   status, reason       Status and the words with its numbers
///   refined              pose and covariance are the refinement's; false: ICLK's
///   T_10                 4x4, row-major nested lists: the final pose, camera 0 to camera 1
///   covariance           6x6 of [rho, phi], T_10 = mean Exp(xi); nulls where there is none
///   turn                 RefinedAlignment::turn: of a rolling shutter, rad; null unless proven
///   stages               name, T_10, cost, ms; with a truth e_pixel [px], e_transl [m], e_rot [rad]
///   levels               coarse to fine: level, scale, iterations (cost, visible, step, lambda, accepted)
///   features             u0, v0, inverse_depth, u1, v1, status; pixels of the undistorted images; with refinement covariance,
///                        2x2 of u1, v1, px^2; with the setting structure, inverse_depth_sigma
///   camera               fx, fy, cx, cy, width, height of those images
///   gain, bias           target = gain reference + bias, grey in [0, 1], of the whole pair, as ICLK found them
///   visible_fraction, device, timing_ms
///
/// Every number is finite or null.
nlohmann::ordered_json to_json(const PairInput& pair, const RefinedAlignment& result, const Session& session);

/// What a person wants to know: stages (with errors where there is a truth), features, pose, status and, unless converged, a
/// hint.
std::string to_table(const PairInput& pair, const RefinedAlignment& result, const Session& session);

/// A stage against the truth of the pair, which has one. feature_alignment: e_pixel is that of the aligned positions (NaN
/// without any), the pose that by which the last round warped.
PoseError stage_error(const PairInput& pair, const RefinedAlignment& result, const Stage& stage);

/// One line that says what to try next; empty for converged. `feature_file`: the features were given, not chosen.
std::string hint(Status status, bool feature_file = false);

}  // namespace iclk
