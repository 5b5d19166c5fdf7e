// The readers of small text files, for iclk.ray, which decodes pixels itself.
#include <cmath>
#include <string>
#include <tuple>
#include <vector>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/session/depth_sigma.h>
#include <iclk/session/io/camera_file.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/feature_csv.h>

#include "apps/json/manifest.h"
#include "python/arrays.h"
#include "python/bindings.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

using LensText = std::pair<std::string, nb::tuple>;  ///< "none", "radtan" or "equidistant", and its coefficients

/// A Python function (path, most bytes) -> bytes. What it raises goes through.
FileReader reader(const nb::callable& read) {
  return [read](const std::string& path, size_t most) {
    const auto bytes = nb::cast<nb::bytes>(read(path, most));
    return std::string(bytes.c_str(), bytes.size());
  };
}

LensText lens_text(const Distortion& distortion) {
  const bool radtan = distortion.model == Distortion::Model::radtan;
  nb::list k;
  for (const double x : distortion.k) k.append(x);
  return {distortion.empty() ? "none" : radtan ? "radtan" : "equidistant", nb::tuple(k)};
}

double lens_radius(const std::string& model, const std::vector<double>& k) {
  return Lens(make_distortion(model, k, "distortion")).radius();
}

CameraFile fitted(const CameraFile& file, int width, int height) {
  CameraFile out = file;
  out.camera = fit_camera(file, width, height);
  return out;
}

std::tuple<NewArray<double>, NewArray<double>, NewArray<double>> parse_features(const nb::bytes& text,
                                                                                const std::string& name) {
  const Features f = iclk::parse_features({text.c_str(), text.size()}, name);
  std::vector<double> uv;
  for (const Eigen::Vector2d& p : f.uv) uv.insert(uv.end(), {p.x(), p.y()});
  return {to_array(uv.data(), {f.uv.size(), 2}), to_array(f.inverse_depth), to_array(f.inverse_depth_sigma)};
}

/// Sigmas of the inverse depths: where there are none, those that `text` says.
NewArray<double> depth_sigma(const std::string& text, double fx, const Vector& inverse_depth, const Vector& sigma) {
  Features f;
  f.inverse_depth.assign(inverse_depth.data(), inverse_depth.data() + inverse_depth.size());
  f.inverse_depth_sigma.assign(sigma.data(), sigma.data() + sigma.size());
  f.uv.resize(f.inverse_depth.size());
  Camera camera;
  camera.fx = fx;
  parse_depth_sigma(text).apply(camera, f);
  return to_array(f.inverse_depth_sigma);
}

nb::typed<nb::dict, nb::str, nb::any> parse_request(const std::string& text, const std::string& where,
                                                    const std::string& folder, const nb::callable& read) {
  const PairRequest request = iclk::parse_request(text, where, folder, reader(read));
  nb::typed<nb::dict, nb::str, nb::any> out;
  const auto add = [&](const char* key, const auto& value) { out[key] = value ? nb::cast(*value) : nb::none(); };
  const auto add_file = [&](const char* key, const std::string& file) {
    out[key] = file.empty() ? nb::object(nb::none()) : nb::cast(file);
  };
  const auto add_pose = [&](const char* key, const std::optional<SE3>& T) {
    out[key] = T ? nb::cast(to_array(*T)) : nb::none();
  };
  add_file("reference", request.files.reference);
  add_file("target", request.files.target);
  add_file("depth", request.files.depth);
  add_file("features", request.files.features);
  add_file("reference_mask", request.files.reference_mask);
  add_file("target_mask", request.files.target_mask);
  add("camera", request.camera);
  add("distortion", request.distortion);
  add("depth_scale", request.depth_scale);
  add_pose("T_10", request.T_10);
  add_pose("truth", request.truth);
  return out;
}

}  // namespace

void bind_readers(nb::module_& m) {
  nb::class_<CameraFile>(m, "CameraFile")
      .def_prop_ro("fx", [](const CameraFile& c) { return c.camera.fx; })
      .def_prop_ro("fy", [](const CameraFile& c) { return c.camera.fy; })
      .def_prop_ro("cx", [](const CameraFile& c) { return c.camera.cx; })
      .def_prop_ro("cy", [](const CameraFile& c) { return c.camera.cy; })
      .def_prop_ro("width", [](const CameraFile& c) { return c.camera.width; })
      .def_prop_ro("height", [](const CameraFile& c) { return c.camera.height; })
      .def_prop_ro("depth_scale", [](const CameraFile& c) { return c.depth_scale; })
      .def_prop_ro("distortion", [](const CameraFile& c) { return lens_text(c.distortion); })
      .def("fitted", &fitted, nb::arg("width"), nb::arg("height"));
  m.def(
      "load_camera", [](const std::string& text, const nb::callable& read) { return load_camera(text, reader(read)); },
      nb::arg("text"), nb::arg("read"));
  m.def(
      "parse_distortion", [](const std::string& text) { return lens_text(parse_distortion(text)); }, nb::arg("text"));
  m.def("lens_radius", &lens_radius, nb::arg("model"), nb::arg("k"));
  m.def("parse_features", &parse_features, nb::arg("text"), nb::arg("name"));
  m.def("depth_sigma", &depth_sigma, nb::arg("text"), nb::arg("fx"), nb::arg("inverse_depth"), nb::arg("sigma"));
  m.def("parse_request", &parse_request, nb::arg("text"), nb::arg("where"), nb::arg("folder"), nb::arg("read"));
}

}  // namespace iclk::python
