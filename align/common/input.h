#pragma once
#include <string>

#include <iclk/align/aligner.h>

namespace iclk::internal {

/// The checks at the door, the same for every solver. Each throws Error(invalid_argument) with the numbers.
void check_slot(int slot, const Plan& plan);
void check_image(const ImageView& image, const char* what, const Plan& plan);
void check_reference(const Reference& reference, const Plan& plan);
void check_reference_data(const Reference& reference, const Plan& plan);  ///< camera and number of features only
void check_pair(const Pair& pair, size_t index, const Plan& plan);
void check_pose(const Pair& pair, const std::string& which);  ///< first guess and prior only

/// Mean inverse depth of what takes part: usable features, or valid pixels in dense mode. 0 if there is none.
double mean_inverse_depth(const Reference& reference, std::span<const FeatureCheck> checks, bool dense);

}  // namespace iclk::internal
