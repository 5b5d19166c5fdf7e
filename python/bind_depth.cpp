#include <limits>
#include <optional>
#include <string>
#include <tuple>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/depth/depth_sweep.h>
#include <iclk/engine/error.h>

#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

using Source = std::tuple<Array, Pose, Intrinsics>;

/// As `iclk depth` does it. near 0: as the priors, with a margin.
std::tuple<NewArray<float>, NewArray<float>, double, double, double, int, std::string, std::string> depth_map(
    const Array& reference, const Intrinsics& intrinsics, const std::vector<Source>& views, double near, double far,
    const Points& uv, const Vector& inverse_depth, int planes, bool fill_gaps, const std::string& device) {
  const ImageView image = image_view(reference);
  const Camera camera = python::camera(intrinsics, image.width, image.height);
  const Features priors = features(uv, inverse_depth, nullptr);
  std::vector<DepthSource> sources;
  std::vector<Camera> cameras;
  std::vector<SE3> poses;
  for (const auto& [view, T_10, K] : views) {
    const ImageView pixels = image_view(view);
    cameras.push_back(python::camera(K, pixels.width, pixels.height));
    poses.push_back(pose(T_10));
    sources.push_back({pixels, cameras.back(), poses.back()});
  }
  DepthRange range{near, far};
  if (near == 0) {
    if (priors.size() == 0)
      throw Error(ErrorCode::invalid_argument, "the depth range is unknown: give near and far, or sparse uv and depth");
    range = range_of(priors.inverse_depth);
  }
  range.check();
  DepthPlan plan{image.width, image.height, planes, static_cast<int>(sources.size())};
  if (planes == 0) plan.planes = planes_for(camera, cameras, poses, range);
  plan.check();
  const auto context = shared_device(device);
  DepthMap map;
  {
    const Working working;
    DepthOptions options;
    options.keep_unseen = fill_gaps;
    DepthSweep sweep(context, plan, options);
    map = sweep.compute(image, camera, sources, range, priors);
    if (fill_gaps) fill(map);
  }
  check_signals();
  for (float& q : map.inverse_depth.data) q = q > 0 ? 1 / q : 0;
  const std::vector<size_t> shape{static_cast<size_t>(image.height), static_cast<size_t>(image.width)};
  return {to_array(std::move(map.inverse_depth.data), shape),
          to_array(std::move(map.confidence.data), shape),
          map.valid,
          range.near,
          range.far,
          plan.planes,
          name(map.status),
          map.reason};
}

}  // namespace

void bind_depth(nb::module_& m) {
  m.def("depth_map", &depth_map, nb::arg("reference"), nb::arg("intrinsics"), nb::arg("views"), nb::arg("near"), nb::arg("far"),
        nb::arg("uv"), nb::arg("inverse_depth"), nb::arg("planes"), nb::arg("fill"), nb::arg("device"));
}

}  // namespace iclk::python
