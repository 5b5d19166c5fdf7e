#pragma once
#include <string>
#include <string_view>
#include <vector>

#include <iclk/align/se3.h>
#include <iclk/session/io/text.h>

namespace iclk {

/// Parses a pose: a TUM line "[timestamp] tx ty tz qx qy qz qw", or a 4x4 (or 3x4) matrix row by row. Blanks, commas,
/// semicolons and brackets separate the numbers, so `T_10` of iclk's JSON can be pasted. Throws Error(invalid_argument) that
/// begins with `what` for words that are not finite numbers, a wrong count, and a matrix without a rotation.
SE3 parse_pose(std::string_view text, const std::string& what);
/// The same, for a text or the path of a file with it. Throws also the errors of `read`.
SE3 load_pose(const std::string& text_or_path, const std::string& what, const FileReader& read = read_file);

/// Throws Error(invalid_argument) unless all seven are finite and the quaternion has norm 1 within 1e-2, because TUM files have
/// four digits.
SE3 pose_from_tum(const double* tx_ty_tz_qx_qy_qz_qw, const std::string& what);

/// Formats a pose as "tx ty tz qx qy qz qw" with qw >= 0. Parsing the text gives the pose within 1e-9.
std::string tum_line(const SE3& T);

struct StampedPose {
  double stamp = 0;
  SE3 T_wc;  ///< camera to world
};

/// Loads a TUM trajectory, sorted by time. Throws Error(invalid_argument) "`file`:`line`: ..." for an invalid line.
std::vector<StampedPose> load_trajectory(const std::string& path);

/// The longest gap in a true trajectory over which poses are interpolated, s. Motion capture has longer dropouts.
inline constexpr double kMaxTruthGap = 0.25;

/// Interpolates between the neighbours of `stamp`: linear translation, slerp rotation. Returns false if `stamp` lies outside
/// the trajectory, or if the neighbours are more than max_gap seconds apart and neither has this time.
bool interpolate(const std::vector<StampedPose>& trajectory, double stamp, double max_gap, SE3& T_wc);

}  // namespace iclk
