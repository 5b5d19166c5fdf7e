#pragma once
#include <string>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/refine/refiner.h>

namespace iclk {

/// Whether the result has a covariance. A refinement that ends in max_iterations has none, which is not a covariance of zero.
bool has_covariance(const RefinedAlignment& result);

/// The status of feature i for JSON, pictures and Python: a FeatureStatus, or the FeatureCheck of a rejected feature. Without
/// refinement: "projected" or "out_of_image".
std::string feature_status(const Camera& camera, const Features& features, const RefinedAlignment& result, int i);

/// Sets uv1 to the position of feature i in image 1: the aligned one, else its projection by the final pose. Returns false if
/// it has no position.
bool feature_position(const Camera& camera, const Features& features, const RefinedAlignment& result, int i,
                      Eigen::Vector2d& uv1);

}  // namespace iclk
