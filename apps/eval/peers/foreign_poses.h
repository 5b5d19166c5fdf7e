#pragma once
#include <map>
#include <string>

#include <iclk/align/se3.h>

namespace iclk {

/// Poses that another program found, a JSON object a line:
///
///   {"id": "000007", "T_10": [[...],[...],[...],[0,0,0,1]], "claimed": true, "ms": 85.2}
///
///   id        of the manifest, as exported_id() has it
///   T_10      camera 0 to camera 1, as a manifest's truth; null or missing: no pose
///   claimed   whether the method says that it succeeded; else `"status": "converged"` says so, where there is one; else every
///             pose is a claim
///   ms        a pair, optional
///
/// Other keys and lines without an id, such as the header of `iclk batch`, are left alone, so its results can be read too.
class ForeignPoses {
 public:
  struct Pose {
    bool has_pose = false, claimed = false;
    SE3 T_10;
    double ms = 0;  ///< NaN: not said
  };

  /// `argument`: NAME=FILE; the name is that of the row. Throws Error(invalid_argument) without a name, for broken lines, ids
  /// that come twice and what is not a pose, each with "<file>:<line>"; Error(io) for a file that cannot be read.
  explicit ForeignPoses(const std::string& argument);

  const std::string& name() const { return name_; }
  /// Throws Error(invalid_argument) if there is no line: a share of the pairs that are there would be another set's.
  const Pose& of(const std::string& id) const;

 private:
  std::string name_, path_;
  std::map<std::string, Pose> poses_;
};

}  // namespace iclk
