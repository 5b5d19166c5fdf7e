#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>
#include <iclk/session/depth_values.h>
#include <iclk/session/detect.h>
#include <iclk/session/models.h>

#include "apps/json/model_info.h"
#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

std::pair<NewArray<double>, NewArray<double>> detect(const Array& image, const Array& depth, const std::optional<Array>& mask,
                                                     const std::string& detector, int count, uint64_t seed) {
  DetectorOptions options;
  options.detector = parse_detector(detector);
  options.count = count;
  options.seed = seed;
  const ImageView pixels = image_view(image), metres = image_view(depth), seen = mask ? image_view(*mask) : ImageView();
  Features found;
  {
    const Working working;
    found = detect_features(pixels, metres, seen, options);
  }
  std::vector<double> uv;
  for (const Eigen::Vector2d& p : found.uv) uv.insert(uv.end(), {p.x(), p.y()});
  return {to_array(uv.data(), {found.uv.size(), 2}), to_array(found.inverse_depth)};
}

/// A copy without what is no measurement.
NewArray<float> measured(const Array& depth) {
  const ImageView metres = image_view(depth);
  const auto count = static_cast<size_t>(metres.width) * static_cast<size_t>(metres.height);
  const auto* const first = static_cast<const float*>(metres.data);
  std::vector<float> out(first, first + count);
  keep_measured(out);
  return to_array(std::move(out), {static_cast<size_t>(metres.height), static_cast<size_t>(metres.width)});
}

std::string info(const std::string& model, int width, int height, const std::vector<std::string>& folders) {
  return model_json(load_model(find_model(model, folders)), width, height).dump();
}

}  // namespace

void bind_functions(nb::module_& m) {
  m.def("devices", &devices);
  m.def("detect", &detect, nb::arg("image"), nb::arg("depth"), nb::arg("mask").none(), nb::arg("detector"), nb::arg("count"),
        nb::arg("seed"));
  m.def("keep_measured", &measured, nb::arg("depth"));
  m.def("model_info", &info, nb::arg("model"), nb::arg("width"), nb::arg("height"), nb::arg("folders"));
}

}  // namespace iclk::python
