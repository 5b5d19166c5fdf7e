#pragma once
#include <span>
#include <vector>

#include <Eigen/Core>

namespace iclk::internal {

using Matrix12d = Eigen::Matrix<double, 12, 12>;

/// The rows of the Jacobian for a state of a chain: rows of this state, and rows that couple it to the next one.
struct ChainLink {
  Eigen::Matrix<double, Eigen::Dynamic, 12> own;
  Matrix12d to_next = Matrix12d::Zero(), next = Matrix12d::Zero();  ///< zero for the last
};

/// The diagonal blocks of (J^T J)^-1, one per state, in linear time. QR runs from link to link and back, which avoids squaring
/// the condition number. Blocks of states that the rows do not determine are not finite.
std::vector<Matrix12d> chain_covariances(std::span<const ChainLink> links);

}  // namespace iclk::internal
