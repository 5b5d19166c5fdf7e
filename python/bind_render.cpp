#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <tuple>

#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <iclk/engine/error.h>
#include <iclk/render/pairs.h>
#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>

#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

/// H x W x 3 and H x W metres.
using Arrays = std::tuple<NewArray<uint8_t>, NewArray<float>>;

/// iclk._core.Terrain.
class BoundTerrain {
 public:
  BoundTerrain(uint64_t seed, double size, const std::string& device) : renderer_("Terrain") {
    const auto context = shared_device(device);
    const Working working;
    ProceduralOptions options;
    options.seed = seed;
    options.size = size;
    renderer_.reset(std::make_unique<TerrainRenderer>(context, std::make_shared<const Terrain>(procedural_terrain(options)),
                                                      RenderOptions()));
  }

  Arrays render(const Pose& T_WC, const Intrinsics& intrinsics, int width, int height) {
    const SE3 where = pose(T_WC);
    const Camera camera = python::camera(intrinsics, width, height);
    View view;
    {
      const Working working;
      const auto lock = renderer_.lock();
      view = renderer_.get()->render(camera, where);
    }
    return to_arrays(view);
  }

  std::tuple<Arrays, Arrays, NewArray<double>, NewArray<double>, NewArray<double>> pair(
      uint64_t index, const Intrinsics& intrinsics, int width, int height, double altitude_min, double altitude_max,
      double tilt, double translation, double rotation, uint64_t seed) {
    PairOptions options;
    options.camera = camera(intrinsics, width, height);
    options.altitude_min = altitude_min;
    options.altitude_max = altitude_max;
    options.tilt = tilt;
    options.translation = translation;
    options.rotation = rotation;
    options.seed = seed;
    RenderedPair drawn;
    {
      const Working working;
      const auto lock = renderer_.lock();
      drawn = PairSource(*renderer_.get(), options).draw(index);
    }
    return {to_arrays(drawn.view0), to_arrays(drawn.view1), to_array(drawn.T_10), to_array(drawn.T_W0), to_array(drawn.T_W1)};
  }

  double height_at(double x, double y) {
    const Working working;
    const auto lock = renderer_.lock();
    return renderer_.get()->terrain().height_at(x, y).value_or(NAN);
  }

 private:
  Owned<TerrainRenderer> renderer_;
};

}  // namespace

void bind_render(nb::module_& m) {
  nb::class_<BoundTerrain>(m, "Terrain")
      .def(nb::init<uint64_t, double, const std::string&>(), nb::arg("seed"), nb::arg("size"), nb::arg("device"))
      .def("render", &BoundTerrain::render, nb::arg("T_WC"), nb::arg("intrinsics"), nb::arg("width"), nb::arg("height"))
      .def("pair", &BoundTerrain::pair, nb::arg("index"), nb::arg("intrinsics"), nb::arg("width"), nb::arg("height"),
           nb::arg("altitude_min"), nb::arg("altitude_max"), nb::arg("tilt"), nb::arg("translation"), nb::arg("rotation"),
           nb::arg("seed"))
      .def("height_at", &BoundTerrain::height_at, nb::arg("x"), nb::arg("y"));
}

}  // namespace iclk::python
