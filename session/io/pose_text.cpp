#include <iclk/session/io/pose_text.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include <Eigen/Geometry>

#include <iclk/engine/error.h>

namespace iclk {
namespace {

[[noreturn]] void fail(const std::string& what, const std::string& why) {
  throw Error(ErrorCode::invalid_argument, what + ": " + why);
}

}  // namespace

SE3 pose_from_tum(const double* x, const std::string& what) {
  for (int i = 0; i < 7; ++i)
    if (!std::isfinite(x[i])) fail(what, "the pose is not finite");
  const Eigen::Quaterniond q(x[6], x[3], x[4], x[5]);
  if (std::abs(q.norm() - 1) > 1e-2)
    fail(what, "the quaternion qx qy qz qw has norm " + std::to_string(q.norm()) + ", not 1: not a rotation");
  return {q.normalized().toRotationMatrix(), {x[0], x[1], x[2]}};
}

SE3 parse_pose(std::string_view text, const std::string& what) {
  std::string bare;
  for (const std::string_view line : lines_of(text)) bare.append(without_comment(line)).append("\n");
  const std::vector<double> x = parse_numbers(bare, what);
  if (x.size() == 7 || x.size() == 8) return pose_from_tum(x.data() + (x.size() - 7), what);
  if (x.size() != 12 && x.size() != 16)
    fail(what, "a TUM line (tx ty tz qx qy qz qw) or a 4x4 matrix is needed, found " + std::to_string(x.size()) + " numbers");
  Eigen::Matrix4d M = Eigen::Matrix4d::Identity();
  for (size_t i = 0; i < x.size(); ++i) M(static_cast<int>(i / 4), static_cast<int>(i % 4)) = x[i];
  try {
    return SE3::from_matrix(M);
  } catch (const Error& e) {
    fail(what, e.what());
  }
}

SE3 load_pose(const std::string& text_or_path, const std::string& what, const FileReader& read) {
  const bool inline_numbers = text_or_path.find_first_not_of("0123456789.,;+-eE \t\r\n[]") == std::string::npos;
  if (inline_numbers && split_words(text_or_path, " \t\r\n,;[]").size() > 1) return parse_pose(text_or_path, what);
  return parse_pose(read(text_or_path, size_t{1} << 20), what + " " + text_or_path);
}

std::string tum_line(const SE3& T) {
  Eigen::Quaterniond q(T.R);
  if (q.w() < 0) q.coeffs() *= -1;
  char line[256];
  std::snprintf(line, sizeof line, "%.10g %.10g %.10g %.12g %.12g %.12g %.12g", T.t.x(), T.t.y(), T.t.z(), q.x(), q.y(), q.z(),
                q.w());
  return line;
}

std::vector<StampedPose> load_trajectory(const std::string& path) {
  const std::string text = read_file(path);
  std::vector<StampedPose> poses;
  int number = 0;
  for (const std::string_view raw : lines_of(text)) {
    ++number;
    const std::string_view line = without_comment(raw);
    if (line.empty()) continue;
    const std::string where = path + ":" + std::to_string(number);
    const std::vector<double> x = parse_numbers(line, where);
    if (x.size() != 8) fail(where, "'timestamp tx ty tz qx qy qz qw' expected, found " + std::to_string(x.size()) + " numbers");
    if (!std::isfinite(x[0])) fail(where, "the timestamp is not finite");
    poses.push_back({x[0], pose_from_tum(x.data() + 1, where)});
  }
  std::stable_sort(poses.begin(), poses.end(), [](const auto& a, const auto& b) { return a.stamp < b.stamp; });
  return poses;
}

bool interpolate(const std::vector<StampedPose>& trajectory, double stamp, double max_gap, SE3& T_wc) {
  const auto after =
      std::lower_bound(trajectory.begin(), trajectory.end(), stamp, [](const StampedPose& p, double s) { return p.stamp < s; });
  if (after == trajectory.end()) return false;
  if (after->stamp == stamp) {
    T_wc = after->T_wc;
    return true;
  }
  if (after == trajectory.begin()) return false;
  const auto before = after - 1;
  if (after->stamp - before->stamp > max_gap) return false;
  const double s = (stamp - before->stamp) / (after->stamp - before->stamp);
  const Eigen::Quaterniond a(before->T_wc.R), b(after->T_wc.R);
  T_wc.R = a.slerp(s, b).toRotationMatrix();
  T_wc.t = (1 - s) * before->T_wc.t + s * after->T_wc.t;
  return true;
}

}  // namespace iclk
