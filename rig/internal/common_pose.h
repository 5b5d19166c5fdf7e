#pragma once
#include <vector>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// The estimate of one pair for the pose that all pairs share.
struct PoseVote {
  SE3 T;
  Matrix6d covariance = Matrix6d::Identity();  ///< of xi in T Exp(xi), [rho, phi]; positive definite
  double distance = 0;                         ///< output: squared, normalised by the covariance and the spread of the votes
  double weight = 0;                           ///< output: 1 / (1 + distance / 12.6)
};

/// The robust mean by information, sum_i w_i C_i^-1 Log(T_i^-1 T) = 0. It starts at the vote that is nearest to the others,
/// among all votes or a sample of 200. It is therefore right if more than half of the votes agree. If votes are farther apart
/// than their covariances suggest, distances are normalised by their actual spread. Precondition: at least one vote.
SE3 common_pose(std::vector<PoseVote>& votes);

}  // namespace iclk::internal
