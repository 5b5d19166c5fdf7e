#include <iclk/locate/internal/pose_graph.h>

#include <algorithm>
#include <deque>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/refine/internal/reprojection.h>

namespace iclk::internal {
namespace {

constexpr double kLoss = 5;  // standard deviations, of a residual with six of them; a right one seldom has more
constexpr int kIterations = 30;

int other_end(const BundleEdge& edge, int frame) { return edge.from == frame ? edge.to : edge.from; }

}  // namespace

int PoseGraph::add() {
  nodes_.emplace_back();
  return size() - 1;
}

void PoseGraph::anchor(int frame, const SE3& T_WC, const Matrix6d& covariance) {
  nodes_[static_cast<size_t>(frame)].anchor = BundleEdge{frame, -1, T_WC, covariance};
}

void PoseGraph::motion(const BundleEdge& edge) {
  for (const int frame : {edge.from, edge.to}) nodes_[static_cast<size_t>(frame)].edges.push_back(edges_.size());
  edges_.push_back(edge);
}

int PoseGraph::anchored_before(int count) const {
  for (int i = size() - 1; i > 0; --i)
    if (node(i).anchored() && --count == 0) return i;
  return 0;
}

double PoseGraph::surprise(int frame) const {
  const Node& n = node(frame);
  if (!n.anchor) return 0;
  const Vector6d xi = (n.anchor->T_to_from.inverse() * n.T_WC).log();
  return std::sqrt(std::max(0.0, xi.dot(n.anchor->covariance.ldlt().solve(xi))));
}

/// The frames from `first` on, and those before that their motions lead to, up to the next anchors.
std::vector<int> PoseGraph::involved(int first) const {
  std::vector<bool> taken(nodes_.size());
  std::deque<int> open;
  for (int i = first; i < size(); ++i) taken[static_cast<size_t>(i)] = true, open.push_back(i);
  while (!open.empty()) {
    const int i = open.front();
    open.pop_front();
    if (i < first && node(i).anchored()) continue;
    for (const size_t e : node(i).edges) {
      const int j = other_end(edges_[e], i);
      if (!taken[static_cast<size_t>(j)]) taken[static_cast<size_t>(j)] = true, open.push_back(j);
    }
  }
  std::vector<int> frames;
  for (int i = 0; i < size(); ++i)
    if (taken[static_cast<size_t>(i)]) frames.push_back(i);
  return frames;
}

/// Those that hang on an anchor. Unknown poses follow from their neighbours.
std::vector<int> PoseGraph::connect(const std::vector<int>& frames) {
  std::vector<bool> reached(nodes_.size());
  std::deque<int> open;
  const auto reach = [&](int i, const SE3& T_WC) {
    Node& n = nodes_[static_cast<size_t>(i)];
    if (!n.known) n.T_WC = T_WC, n.known = true;
    reached[static_cast<size_t>(i)] = true;
    open.push_back(i);
  };
  for (const int i : frames)
    if (node(i).anchored()) reach(i, node(i).anchor->T_to_from);
  while (!open.empty()) {
    const int i = open.front();
    open.pop_front();
    for (const size_t e : node(i).edges) {
      const int j = other_end(edges_[e], i);
      if (reached[static_cast<size_t>(j)] || !std::binary_search(frames.begin(), frames.end(), j)) continue;
      const SE3& T = edges_[e].T_to_from;
      reach(j, node(i).T_WC * (edges_[e].from == i ? T.inverse() : T));
    }
  }
  std::vector<int> connected;
  std::copy_if(frames.begin(), frames.end(), std::back_inserter(connected),
               [&](int i) { return reached[static_cast<size_t>(i)]; });
  return connected;
}

void PoseGraph::solve(int first, int last) {
  const std::vector<int> frames = connect(involved(first));
  if (frames.empty()) return;
  // Ceres orders parameters by address: in one array, equal graphs give equal bits.
  std::vector<PoseBlock> blocks;
  std::vector<int> slots(nodes_.size(), -1);
  for (const int i : frames)
    slots[static_cast<size_t>(i)] = static_cast<int>(blocks.size()), blocks.push_back(to_block(node(i).T_WC));
  blocks.push_back(to_block(SE3()));  // the map
  const auto slot = [&](int i) { return slots[static_cast<size_t>(i)]; };
  const auto block = [&](int i) { return blocks[static_cast<size_t>(slot(i))].data(); };
  ceres::Problem problem;
  for (PoseBlock& b : blocks) problem.AddParameterBlock(b.data(), 12, new PoseManifold);
  problem.SetParameterBlockConstant(blocks.back().data());
  const auto add = [&](const BundleEdge& edge, double* to, ceres::LossFunction* loss) {
    problem.AddResidualBlock(new EdgeCost(edge), loss, block(edge.from), to);
  };
  for (const int i : frames) {
    if (node(i).anchored()) add(*node(i).anchor, blocks.back().data(), new ceres::CauchyLoss(kLoss));
    for (const size_t e : node(i).edges)
      if (edges_[e].to == i && slot(edges_[e].from) >= 0) add(edges_[e], block(i), nullptr);
  }
  ceres::Solver::Options options = solver_options(kIterations);
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return;
  ceres::Covariance::Options how;
  how.algorithm_type = ceres::SPARSE_QR;
  ceres::Covariance covariance(how);
  std::vector<std::pair<const double*, const double*>> wanted;
  for (const int i : frames)
    if (i >= last) wanted.emplace_back(block(i), block(i));
  const bool certain = !wanted.empty() && covariance.Compute(wanted, &problem);
  for (const int i : frames) {
    Node& n = nodes_[static_cast<size_t>(i)];
    n.T_WC = to_pose(block(i));
    n.T_WC.orthonormalize();
    Eigen::Matrix<double, 6, 6, Eigen::RowMajor> C;
    if (certain && i >= last && covariance.GetCovarianceBlockInTangentSpace(block(i), block(i), C.data())) n.covariance = C;
  }
}

}  // namespace iclk::internal
