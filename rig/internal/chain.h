#pragma once
#include <span>
#include <vector>

#include <Eigen/Core>

namespace iclk::internal {

using Matrix12d = Eigen::Matrix<double, 12, 12>;

/// A state of a chain, by the rows of the Jacobian that it brings: of itself alone, and of itself and the next one.
struct ChainLink {
  Eigen::Matrix<double, Eigen::Dynamic, 12> own;
  Matrix12d to_next = Matrix12d::Zero(), next = Matrix12d::Zero();  ///< zero for the last
};

/// The states' own blocks of (J^T J)^-1, in time that grows with their number: QR from link to link, which squares no
/// condition, and back. Not finite where the rows do not determine a state.
std::vector<Matrix12d> chain_covariances(std::span<const ChainLink> links);

}  // namespace iclk::internal
