#pragma once
#include <string>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/refine/refiner.h>

namespace iclk {

/// No covariance is not a covariance of zero: a refinement that ends in max_iterations has none.
bool has_covariance(const RefinedAlignment& result);

/// The status of feature i as JSON, pictures and Python state it: a FeatureStatus, the FeatureCheck of a rejected one, or
/// without refinement "projected" or "out_of_image".
std::string feature_status(const Camera& camera, const Features& features, const RefinedAlignment& result, int i);

/// Where feature i came to lie in image 1: aligned, else projected by the final pose. False if it has no position.
bool feature_position(const Camera& camera, const Features& features, const RefinedAlignment& result, int i,
                      Eigen::Vector2d& uv1);

}  // namespace iclk
