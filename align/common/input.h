#pragma once
#include <string>

#include <iclk/align/aligner.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

/// The checks of inputs, the same for every solver. Each throws Error(invalid_argument) with the numbers.
void check_slot(int slot, const Plan& plan);
void check_image(const ImageView& image, const char* what, const Plan& plan);
void check_reference(const Reference& reference, const Plan& plan);
void check_reference_data(const Reference& reference, const Plan& plan);  ///< camera and number of features only
void check_pair(const Pair& pair, size_t index, const Plan& plan);
void check_pose(const Pair& pair, const std::string& which);  ///< first guess and prior only

/// The inverse depth of level 0 in dense mode: values that are not finite or not positive become 0.
Map dense_inverse_depth(const ImageView& inverse_depth);

/// The mean inverse depth of usable features, or of valid pixels in dense mode. 0 if there are none.
double mean_inverse_depth(const Reference& reference, std::span<const FeatureCheck> checks, bool dense);

}  // namespace iclk::internal
