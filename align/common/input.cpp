#include <iclk/align/common/input.h>

#include <cmath>
#include <cstring>
#include <string>

#include <Eigen/LU>

#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

std::string size(int width, int height) { return std::to_string(width) + "x" + std::to_string(height); }

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

}  // namespace

void check_slot(int slot, const Plan& plan) {
  if (slot < 0 || slot >= plan.max_references)
    refuse("reference slot " + std::to_string(slot) + " is outside the range of the plan, 0 to " +
           std::to_string(plan.max_references - 1));
}

void check_image(const ImageView& image, const char* what, const Plan& plan) {
  if (image.empty()) refuse(std::string(what) + " is empty (" + size(image.width, image.height) + ")");
  if (image.width != plan.width || image.height != plan.height)
    refuse(std::string(what) + " is " + size(image.width, image.height) + ", but the plan was made for " +
           size(plan.width, plan.height));
  if (image.row_stride && image.row_stride < static_cast<size_t>(image.width) * bytes_per_pixel(image.format))
    refuse(std::string(what) + " has a row stride of " + std::to_string(image.row_stride) + " bytes, shorter than a row");
}

void check_reference(const Reference& reference, const Plan& plan) {
  check_image(reference.image, "reference image", plan);
  check_reference_data(reference, plan);
  if (plan.dense) {
    check_image(reference.inverse_depth, "inverse depth image", plan);
    if (reference.inverse_depth.format != PixelFormat::r32f) refuse("the inverse depth image must have the format r32f");
  }
}

void check_reference_data(const Reference& reference, const Plan& plan) {
  reference.camera.check();
  if (reference.camera.width != plan.width || reference.camera.height != plan.height)
    refuse("camera is for " + size(reference.camera.width, reference.camera.height) + " images, but the reference image is " +
           size(plan.width, plan.height) + "; scale the camera with Camera::resized");
  if (reference.features.size() > plan.max_features)
    refuse(std::to_string(reference.features.size()) + " features, but the plan has room for " +
           std::to_string(plan.max_features));
}

void check_pair(const Pair& pair, size_t index, const Plan& plan) {
  const std::string which = "pair " + std::to_string(index) + ": ";
  check_slot(pair.reference, plan);
  check_image(pair.target, (which + "target image").c_str(), plan);
  if (!pair.target_mask.empty()) {
    check_image(pair.target_mask, (which + "target mask").c_str(), plan);
    if (pair.target_mask.format != PixelFormat::r8) refuse(which + "the target mask must have the format r8");
    if (!plan.target_masks) refuse(which + "a target mask needs a plan with target_masks");
  }
  check_pose(pair, which);
}

void check_pose(const Pair& pair, const std::string& which) {
  if (!pair.T_10.matrix().allFinite()) refuse(which + "initial pose is not finite");
  if (std::abs(pair.T_10.R.determinant() - 1) > 1e-3)
    refuse(which + "rotation of the initial pose is not a rotation (its determinant is not 1)");
  if (pair.prior) {
    if (!pair.prior->T_10.matrix().allFinite() || !pair.prior->information.allFinite())
      refuse(which + "pose prior is not finite");
    const Matrix6d asymmetry = pair.prior->information - pair.prior->information.transpose();
    if (asymmetry.norm() > 1e-6 * pair.prior->information.norm() || pair.prior->information.diagonal().minCoeff() < 0)
      refuse(which + "information of the pose prior is not symmetric and positive semidefinite");
  }
}

Map dense_inverse_depth(const ImageView& inverse_depth) {
  Map map(inverse_depth.width, inverse_depth.height);
  for (int v = 0; v < map.height; ++v) std::memcpy(&map.at(0, v), inverse_depth.row(v), sizeof(float) * map.width);
  for (float& q : map.data)
    if (!(std::isfinite(q) && q > 0)) q = 0;
  return map;
}

double mean_inverse_depth(const Reference& reference, std::span<const FeatureCheck> checks, bool dense) {
  double sum = 0;
  size_t count = 0;
  if (dense) {
    for (float q : dense_inverse_depth(reference.inverse_depth).data)
      if (q > 0) sum += q, ++count;
  } else {
    for (size_t i = 0; i < checks.size(); ++i)
      if (checks[i] == FeatureCheck::ok) sum += reference.features.inverse_depth[i], ++count;
  }
  return count ? sum / static_cast<double>(count) : 0;
}

}  // namespace iclk::internal
