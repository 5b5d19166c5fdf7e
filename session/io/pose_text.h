#pragma once
#include <string>
#include <string_view>
#include <vector>

#include <iclk/align/se3.h>
#include <iclk/session/io/text.h>

namespace iclk {

/// A pose as text or in a file: a TUM line "[timestamp] tx ty tz qx qy qz qw", or a 4x4 (or 3x4) matrix row by row; separated
/// by blanks, commas, semicolons or brackets (so `T_10` of our JSON can be pasted). Throws Error(invalid_argument) that begins
/// with `what`: not a number, another count, not finite, not a rotation.
SE3 parse_pose(std::string_view text, const std::string& what);
SE3 load_pose(const std::string& text_or_path, const std::string& what, const FileReader& read = read_file);

/// Throws Error(invalid_argument) unless finite and of norm 1 within 1e-2 (TUM files carry four digits).
SE3 pose_from_tum(const double* tx_ty_tz_qx_qy_qz_qw, const std::string& what);

/// "tx ty tz qx qy qz qw", qw >= 0, enough digits to come back within 1e-9.
std::string tum_line(const SE3& T);

struct StampedPose {
  double stamp = 0;
  SE3 T_wc;  ///< camera to world
};

/// A TUM trajectory, sorted by time. Throws Error(invalid_argument) "<file>:<line>: ..." for a broken line.
std::vector<StampedPose> load_trajectory(const std::string& path);

/// s: motion capture drops out at times, and a straight line over more is no truth.
inline constexpr double kMaxTruthGap = 0.25;

/// Translation linear, rotation slerp, between the neighbours of `stamp`; false if it lies outside the trajectory or the
/// neighbours are more than max_gap seconds apart (unless one is exact).
bool interpolate(const std::vector<StampedPose>& trajectory, double stamp, double max_gap, SE3& T_wc);

}  // namespace iclk
