#include <Eigen/QR>

#include <iclk/rig/internal/chain.h>

namespace iclk::internal {
namespace {

/// The information of all links up to one: R_own x + R_next x_next, each row of unit variance.
struct Eliminated {
  Matrix12d own, next;
};

}  // namespace

std::vector<Matrix12d> chain_covariances(std::span<const ChainLink> links) {
  std::vector<Eliminated> eliminated;
  Matrix12d carried = Matrix12d::Zero();
  for (const ChainLink& link : links) {
    const Eigen::Index own = link.own.rows();
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(24 + own, 24);
    rows.topLeftCorner<12, 12>() = carried;
    rows.block<12, 12>(12, 0) = link.to_next;
    rows.block<12, 12>(12, 12) = link.next;
    rows.bottomLeftCorner(own, 12) = link.own;
    const Eigen::HouseholderQR<Eigen::MatrixXd> qr(rows);
    const Eigen::Matrix<double, 24, 24> R = qr.matrixQR().topRows<24>().triangularView<Eigen::Upper>();
    eliminated.push_back({R.topLeftCorner<12, 12>(), R.topRightCorner<12, 12>()});
    carried = R.bottomRightCorner<12, 12>();
  }
  std::vector<Matrix12d> covariances(links.size());
  Matrix12d next = Matrix12d::Zero();
  for (size_t i = links.size(); i-- > 0;) {
    const Matrix12d inverse = eliminated[i].own.triangularView<Eigen::Upper>().solve(Matrix12d::Identity());
    const Matrix12d& to_next = eliminated[i].next;
    next = inverse * (Matrix12d::Identity() + to_next * next * to_next.transpose()) * inverse.transpose();
    covariances[i] = next;
  }
  return covariances;
}

}  // namespace iclk::internal
