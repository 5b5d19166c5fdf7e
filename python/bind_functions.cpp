#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>
#include <iclk/track/detector.h>

#include "apps/session/model_info.h"
#include "apps/session/model_lookup.h"
#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

std::pair<NewArray<double>, NewArray<double>> detect(const Array& image, const Array& depth, int count) {
  const ImageView pixels = image_view(image), metres = image_view(depth);
  if (metres.format != PixelFormat::r32f || metres.width != pixels.width || metres.height != pixels.height)
    throw Error(ErrorCode::invalid_argument, "depth is " + std::to_string(metres.width) + "x" + std::to_string(metres.height) +
                                                 ", the image " + std::to_string(pixels.width) + "x" +
                                                 std::to_string(pixels.height) + ": they must have one size");
  if (count < 1 || count > 100000)
    throw Error(ErrorCode::invalid_argument, "feature count " + std::to_string(count) + " must lie in 1 to 100000");
  Features found;
  {
    const Working working;
    DetectorSettings settings;
    settings.count = count;
    found = detect_features(grey_map(pixels), metres, {}, settings);
  }
  std::vector<double> uv;
  for (const Eigen::Vector2d& p : found.uv) uv.insert(uv.end(), {p.x(), p.y()});
  return {to_array(uv.data(), {found.uv.size(), 2}), to_array(found.inverse_depth)};
}

std::string info(const std::string& model, int width, int height, const std::vector<std::string>& folders) {
  return model_json(load_model(find_model(model, folders)), width, height).dump();
}

}  // namespace

void bind_functions(nb::module_& m) {
  m.def("devices", &devices);
  m.def("detect", &detect, nb::arg("image"), nb::arg("depth"), nb::arg("count"));
  m.def("model_info", &info, nb::arg("model"), nb::arg("width"), nb::arg("height"), nb::arg("folders"));
}

}  // namespace iclk::python
