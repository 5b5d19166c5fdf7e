#pragma once
#include <optional>
#include <vector>

#include <iclk/track/internal/edge_cost.h>

namespace iclk::internal {

/// Poses T_WC of the frames of a sequence, from poses that were found on the map (anchors) and motions between frames. Anchors
/// have a Cauchy loss, so that wrong ones do not matter if most are right. Motions have none: else a single one would give way
/// to several anchors that are wrong together.
class PoseGraph {
 public:
  /// Adds a frame with an unknown pose. Returns its number.
  int add();
  /// `covariance`: of xi in T_WC Exp(xi).
  void anchor(int frame, const SE3& T_WC, const Matrix6d& covariance);
  void motion(const BundleEdge& edge);
  /// Whether the anchor of a frame counts. At first it does.
  void trust(int frame, bool trusted) { nodes_[static_cast<size_t>(frame)].trusted = trusted; }

  /// Adjusts the frames from `first` on, and earlier ones as far as those hang on them. Frames without a connection to an
  /// anchor stay as they are. Covariances are computed of the frames from `last` on.
  void solve(int first, int last);

  int size() const { return static_cast<int>(nodes_.size()); }
  bool known(int frame) const { return node(frame).known; }
  const SE3& pose(int frame) const { return node(frame).T_WC; }  ///< if known()
  const Matrix6d& covariance(int frame) const { return node(frame).covariance; }
  /// Standard deviations between the anchor and the solution; 0 without an anchor.
  double surprise(int frame) const;
  /// The frame that has the `count`-th last anchor that counts; 0 if there are fewer.
  int anchored_before(int count) const;

 private:
  struct Node {
    SE3 T_WC;
    Matrix6d covariance = Matrix6d::Zero();
    bool known = false, trusted = true;
    std::optional<BundleEdge> anchor;  // to the map, which is at the identity
    std::vector<size_t> edges;

    bool anchored() const { return anchor && trusted; }
  };
  const Node& node(int frame) const { return nodes_[static_cast<size_t>(frame)]; }
  std::vector<int> involved(int first) const;
  std::vector<int> connect(const std::vector<int>& frames);

  std::vector<Node> nodes_;
  std::vector<BundleEdge> edges_;
};

}  // namespace iclk::internal
