#include "python/arrays.h"

#include <string>

#include <iclk/engine/error.h>

namespace nb = nanobind;

namespace iclk::python {
namespace {

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

template <class T>
NewArray<T> moved(std::vector<T>&& values, const std::vector<size_t>& shape) {
  auto* kept = new std::vector<T>(std::move(values));
  const nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return {kept->data(), shape.size(), shape.data(), owner};
}

}  // namespace

ImageView image_view(const Array& image) {
  const bool colour = image.ndim() == 3;
  if (image.ndim() != 2 && !(colour && image.shape(2) == 3)) refuse("an image must be H x W or H x W x 3");
  const auto of = [&]<class T>(T, PixelFormat grey, PixelFormat rgb, ImageView& view) {
    if (image.dtype() != nb::dtype<T>()) return false;
    view.format = colour ? rgb : grey;
    return true;
  };
  ImageView view{image.data(), static_cast<int>(image.shape(1)), static_cast<int>(image.shape(0)), 0, PixelFormat::r8};
  if (!of(uint8_t(), PixelFormat::r8, PixelFormat::rgb8, view) && !of(uint16_t(), PixelFormat::r16, PixelFormat::rgb16, view) &&
      !of(float(), PixelFormat::r32f, PixelFormat::rgb32f, view))
    refuse("an image must be uint8, uint16 or float32");
  const auto channels = static_cast<int64_t>(colour ? 3 : 1);
  if (image.shape(0) > 1) {
    const int64_t row = image.stride(0);
    if (row < channels * view.width) refuse("rows of an image overlap or run upwards");
    view.row_stride = static_cast<size_t>(row) * image.itemsize();
  }
  if (view.width > 1 && (image.stride(1) != channels || (colour && image.stride(2) != 1)))
    refuse("the pixels of an image row must be contiguous");
  return view;
}

SE3 pose(const Pose& pose) {
  return SE3::from_matrix(Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(pose.data()));
}

Features features(const Points& uv, const Vector& inverse_depth, const Vector* sigma) {
  const size_t count = uv.shape(0), sigmas = sigma != nullptr ? sigma->shape(0) : 0;
  if (count != inverse_depth.shape(0) || (sigmas != 0 && sigmas != count))
    refuse(std::to_string(count) + " features, " + std::to_string(inverse_depth.shape(0)) + " depths and " +
           std::to_string(sigmas) + " sigmas");
  Features out;
  out.uv.reserve(count);
  for (size_t i = 0; i < count; ++i) out.uv.emplace_back(uv.data()[2 * i], uv.data()[2 * i + 1]);
  out.inverse_depth.assign(inverse_depth.data(), inverse_depth.data() + count);
  if (sigmas != 0) out.inverse_depth_sigma.assign(sigma->data(), sigma->data() + sigmas);
  return out;
}

Camera camera(const Intrinsics& intrinsics, int width, int height) {
  const auto [fx, fy, cx, cy] = intrinsics;
  Camera camera{fx, fy, cx, cy, width, height};
  camera.check();
  return camera;
}

NewArray<double> to_array(const double* values, std::vector<size_t> shape) {
  size_t count = 1;
  for (const size_t n : shape) count *= n;
  return moved(std::vector<double>(values, values + count), shape);
}

NewArray<double> to_array(const std::vector<double>& values) { return to_array(values.data(), {values.size()}); }
NewArray<float> to_array(std::vector<float>&& values, std::vector<size_t> shape) { return moved(std::move(values), shape); }
NewArray<uint8_t> to_array(std::vector<uint8_t>&& values, std::vector<size_t> shape) { return moved(std::move(values), shape); }

std::tuple<NewArray<uint8_t>, NewArray<float>> to_arrays(const View& view) {
  const auto width = static_cast<size_t>(view.width), height = static_cast<size_t>(view.height);
  std::vector<uint8_t> rgb;
  rgb.reserve(3 * view.rgba.size());
  for (const uint32_t texel : view.rgba)
    for (const int shift : {0, 8, 16}) rgb.push_back(static_cast<uint8_t>(texel >> shift));
  return {to_array(std::move(rgb), {height, width, 3}), to_array(std::vector<float>(view.depth), {height, width})};
}

}  // namespace iclk::python
