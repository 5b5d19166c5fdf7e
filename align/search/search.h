#pragma once
#include <vector>

#include <iclk/align/solver/lm.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// The starts of a search about T_10, its own first: X1 = R (T_10 X0) for every rotation R of the grid.
std::vector<SE3> search_starts(const SE3& T_10, const Camera& camera, const AlignerOptions& options);

/// How good a start is: the correlation of the images at `at`; -2 where too little is visible or nothing is finite.
double search_score(const NormalSums& sums, const Point& at, const StartSearch& search);

/// StartSearch on the CPU: the first guess with which the alignment should begin. The device does the same in
/// Stages::search. Levels are finest first, pixels of the reference and maps of the target.
SE3 search_start(const std::vector<Template>& pixels, const Pyramid& f1, const Camera& camera, double mean_inverse_depth,
                 const SE3& T_10, const AlignerOptions& options);

}  // namespace iclk::internal
