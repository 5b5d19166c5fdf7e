#pragma once
#include <tuple>
#include <vector>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/se3.h>
#include <iclk/render/renderer.h>

namespace iclk::python {

/// What Python hands over: iclk/_arrays.py has seen to it that these are NumPy arrays of a type and layout that is taken as it
/// is, and says so where not. What is checked here is what would read outside an array.
using Array = nanobind::ndarray<nanobind::ro, nanobind::device::cpu>;
using Vector = nanobind::ndarray<const double, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;
using Points = nanobind::ndarray<const double, nanobind::shape<-1, 2>, nanobind::c_contig, nanobind::device::cpu>;
using Pose = nanobind::ndarray<const double, nanobind::shape<4, 4>, nanobind::c_contig, nanobind::device::cpu>;
using Intrinsics = std::tuple<double, double, double, double>;  ///< fx, fy, cx, cy

/// H x W or H x W x 3 of uint8, uint16 or float32, colours red first; rows may be padded. Not copied.
ImageView image_view(const Array& image);
SE3 pose(const Pose& pose);
/// Copies. `sigma` of inverse depths may be null or empty.
Features features(const Points& uv, const Vector& inverse_depth, const Vector* sigma);
Camera camera(const Intrinsics& intrinsics, int width, int height);

template <class T>
using NewArray = nanobind::ndarray<nanobind::numpy, T>;
NewArray<double> to_array(const std::vector<double>& values);
NewArray<double> to_array(const double* values, std::vector<size_t> shape);
NewArray<float> to_array(std::vector<float>&& values, std::vector<size_t> shape);
NewArray<uint8_t> to_array(std::vector<uint8_t>&& values, std::vector<size_t> shape);

/// H x W x 3 and H x W metres.
std::tuple<NewArray<uint8_t>, NewArray<float>> to_arrays(const View& view);

template <int Rows, int Columns>
NewArray<double> to_array(const Eigen::Matrix<double, Rows, Columns>& m) {
  const Eigen::Matrix<double, Columns, Rows> transposed = m.transpose();  // which lies in memory row by row
  return to_array(transposed.data(), {static_cast<size_t>(m.rows()), static_cast<size_t>(m.cols())});
}
inline NewArray<double> to_array(const SE3& T) { return to_array(Eigen::Matrix4d(T.matrix())); }

}  // namespace iclk::python
