#pragma once
#include <vector>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// What one pair says of a pose that all share.
struct PoseVote {
  SE3 T;
  Matrix6d covariance = Matrix6d::Identity();  ///< of xi in T Exp(xi), [rho, phi]; positive definite
  double distance = 0;                         ///< set: squared, normalised by the covariance and the votes' own spread
  double weight = 0;                           ///< set: 1 / (1 + distance / 12.6)
};

/// Robust mean by information, sum_i w_i C_i^-1 Log(T_i^-1 T) = 0, begun at the vote, of all or of 200 that are drawn,
/// from which the others are nearest: right as long as more than half of the votes agree. Where votes lie farther apart than
/// their covariances say, distances are measured in what they show. Precondition: there is a vote.
SE3 common_pose(std::vector<PoseVote>& votes);

}  // namespace iclk::internal
