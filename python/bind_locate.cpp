#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/locate/ground.h>
#include <iclk/locate/locator.h>
#include <iclk/locate/sequence_locator.h>

#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

using Corner = std::tuple<double, double, double, double>;  ///< left, top, step_x, step_y, m
using Sigmas = std::tuple<double, double, double, double>;  ///< position and height, m; tilt and heading, rad
using Fields = nb::typed<nb::dict, nb::str, nb::any>;

Grid grid_of(const Array& values, const Corner& corner) {
  const auto& [left, top, step_x, step_y] = corner;
  return {static_cast<int>(values.shape(1)), static_cast<int>(values.shape(0)), left, top, step_x, step_y};
}

/// H x W x 4, uint8: red, green, blue, alpha; and H x W heights, float32. iclk/_locate.py has made them so.
Terrain terrain_of(const Array& mosaic, const Corner& mosaic_corner, const Array& heights, const Corner& heights_corner) {
  Terrain terrain;
  terrain.mosaic = grid_of(mosaic, mosaic_corner), terrain.relief = grid_of(heights, heights_corner);
  const auto* bytes = static_cast<const uint8_t*>(mosaic.data());
  for (size_t i = 0; i < mosaic.size(); i += 4)
    terrain.rgba.push_back(bytes[i] | bytes[i + 1] << 8 | bytes[i + 2] << 16 | static_cast<uint32_t>(bytes[i + 3]) << 24);
  const auto* metres = static_cast<const float*>(heights.data());
  terrain.height.assign(metres, metres + heights.size());
  return terrain;
}

Fields to_dict(const Located& l) {
  Fields out;
  out["status"] = name(l.status);
  out["reason"] = l.reason;
  out["T_WC"] = to_array(l.T_WC);
  out["covariance"] = to_array(l.converged() ? l.covariance : Matrix6d::Constant(NAN));
  nb::list rivals;
  for (const SE3& T : l.rivals) rivals.append(to_array(T));
  out["rivals"] = rivals;
  out["model"] = l.model;
  out["hypotheses"] = l.hypotheses;
  out["rounds"] = l.rounds;
  out["inliers"] = l.inliers;
  out["visible"] = l.visible;
  out["sigma"] = l.sigma;
  return out;
}

LocatePrior prior_of(const Pose& T_WC, const Sigmas& sigmas) {
  const auto& [position, height, tilt, heading] = sigmas;
  return {pose(T_WC), position, height, tilt, heading};
}

Fields to_dict(const SequencePose& p) {
  Fields out;
  out["time"] = p.time;
  out["located"] = to_dict(p.located);
  out["known"] = p.known;
  out["T_WC"] = to_array(p.T_WC);
  out["covariance"] = to_array(p.known ? p.covariance : Matrix6d::Constant(NAN));
  return out;
}

/// iclk._core.Map.
class BoundMap {
 public:
  BoundMap(const Array& mosaic, const Corner& mosaic_corner, const Array& heights, const Corner& heights_corner,
           const std::string& model, const std::string& device, const std::vector<std::string>& folders)
      : locator_("Map") {
    const auto context = shared_device(device);
    LocatorOptions options;
    options.session.model = model, options.session.model_folders = folders, options.session.device = device;
    auto terrain = std::make_shared<const Terrain>(terrain_of(mosaic, mosaic_corner, heights, heights_corner));
    const Working working;
    locator_.reset(std::make_unique<Locator>(context, std::move(terrain), options));
  }

  Owned<Locator>& locator() { return locator_; }

  Fields locate(const Array& image, const Intrinsics& intrinsics, const Pose& T_WC, const Sigmas& sigmas,
                const std::optional<Array>& mask) {
    locator_.check();
    const ImageView pixels = image_view(image);
    const Camera camera = python::camera(intrinsics, pixels.width, pixels.height);
    const LocatePrior prior = prior_of(T_WC, sigmas);
    Located located;
    {
      const Working working;
      const auto lock = locator_.lock();
      located = locator_.get()->locate(pixels, camera, prior, mask ? image_view(*mask) : ImageView());
    }
    check_signals();
    return to_dict(located);
  }

  std::tuple<NewArray<uint8_t>, NewArray<float>> view(const Pose& T_WC, const Intrinsics& intrinsics, int width, int height) {
    const SE3 where = pose(T_WC);
    const Camera camera = python::camera(intrinsics, width, height);
    View view;
    {
      const Working working;
      const auto lock = locator_.lock();
      view = locator_.get()->view(camera, where);
    }
    return to_arrays(view);
  }

  /// X (N x 3) and covariances (N x 3 x 3); NaN where the map has no ground.
  std::tuple<NewArray<double>, NewArray<double>> ground(const Pose& T_WC, const Points& covariance,
                                                        const Intrinsics& intrinsics, int width, int height, const Points& uv,
                                                        double elevation_sigma);

 private:
  Owned<Locator> locator_;
};

std::tuple<NewArray<double>, NewArray<double>> BoundMap::ground(const Pose& T_WC, const Points& covariance,
                                                                const Intrinsics& intrinsics, int width, int height,
                                                                const Points& uv, double elevation_sigma) {
  Located located;
  located.status = Status::converged;
  located.T_WC = pose(T_WC);
  std::copy_n(covariance.data(), std::min<size_t>(36, covariance.size()), located.covariance.data());
  const Camera camera = python::camera(intrinsics, width, height);
  const auto count = uv.shape(0);
  std::vector<double> X(3 * count, NAN), C(9 * count, NAN);
  {
    const Working working;
    const auto lock = locator_.lock();
    const View view = locator_.get()->view(camera, located.T_WC);
    for (size_t i = 0; i < count; ++i) {
      const auto at = ground_point(view, camera, located, {uv.data()[2 * i], uv.data()[2 * i + 1]}, elevation_sigma);
      if (!at) continue;
      std::copy_n(at->X.data(), 3, X.begin() + static_cast<std::ptrdiff_t>(3 * i));
      std::copy_n(at->covariance.data(), 9, C.begin() + static_cast<std::ptrdiff_t>(9 * i));
    }
  }
  return {to_array(X.data(), {count, 3}), to_array(C.data(), {count, 3, 3})};
}

/// iclk._core.Sequence. Its map must outlive it.
class BoundSequence {
 public:
  BoundSequence(BoundMap& map, const Intrinsics& intrinsics, int width, int height, bool masks) : map_(map) {
    const Camera camera = python::camera(intrinsics, width, height);
    const Working working;
    const auto lock = map_.locator().lock();
    sequence_.reset(std::make_unique<SequenceLocator>(*map_.locator().get(), camera, SequenceLocatorOptions{.masks = masks}));
  }

  Fields locate(double time, const Array& image, const std::optional<Pose>& T_WC, const Sigmas& sigmas,
                const std::optional<Array>& mask) {
    LocatorFrame frame{time, image_view(image), mask ? image_view(*mask) : ImageView(), {}};
    if (T_WC) frame.prior = prior_of(*T_WC, sigmas);
    SequencePose pose;
    {
      const Working working;
      const auto lock = map_.locator().lock();
      pose = sequence_.get()->locate(frame);
    }
    check_signals();
    return to_dict(pose);
  }

  nb::list all() {
    std::vector<SequencePose> poses;
    {
      const Working working;
      const auto lock = map_.locator().lock();
      poses = sequence_.get()->all();
    }
    nb::list out;
    for (const SequencePose& pose : poses) out.append(to_dict(pose));
    return out;
  }

 private:
  BoundMap& map_;
  Owned<SequenceLocator> sequence_{"Sequence"};
};

}  // namespace

void bind_locate(nb::module_& m) {
  nb::class_<BoundMap>(m, "Map")
      .def(nb::init<const Array&, const Corner&, const Array&, const Corner&, const std::string&, const std::string&,
                    const std::vector<std::string>&>(),
           nb::arg("mosaic"), nb::arg("mosaic_corner"), nb::arg("heights"), nb::arg("heights_corner"), nb::arg("model"),
           nb::arg("device"), nb::arg("folders"))
      .def("locate", &BoundMap::locate, nb::arg("image"), nb::arg("intrinsics"), nb::arg("T_WC"), nb::arg("sigmas"),
           nb::arg("mask").none())
      .def("view", &BoundMap::view, nb::arg("T_WC"), nb::arg("intrinsics"), nb::arg("width"), nb::arg("height"))
      .def("ground", &BoundMap::ground, nb::arg("T_WC"), nb::arg("covariance"), nb::arg("intrinsics"), nb::arg("width"),
           nb::arg("height"), nb::arg("uv"), nb::arg("elevation_sigma"));
  nb::class_<BoundSequence>(m, "Sequence")
      .def(nb::init<BoundMap&, const Intrinsics&, int, int, bool>(), nb::arg("map"), nb::arg("intrinsics"), nb::arg("width"),
           nb::arg("height"), nb::arg("masks"), nb::keep_alive<1, 2>())
      .def("locate", &BoundSequence::locate, nb::arg("time"), nb::arg("image"), nb::arg("T_WC").none(), nb::arg("sigmas"),
           nb::arg("mask").none())
      .def("all", &BoundSequence::all);
}

}  // namespace iclk::python
