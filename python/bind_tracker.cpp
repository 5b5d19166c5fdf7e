#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/session/session.h>
#include <iclk/track/tracker.h>

#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

/// iclk._core.Tracker: a tracker with the aligner that `iclk track` makes for it.
class BoundTracker {
 public:
  BoundTracker(const Intrinsics& intrinsics, int width, int height, const std::string& model, const std::string& solver,
               const std::string& device, const std::vector<std::string>& folders, int features, int keyframes, int window,
               double min_visible, double readout, const std::string& depth_sigma, bool masks) {
    TrackerOptions options;
    options.features = features;
    options.keyframes = keyframes;
    options.window = window;
    options.min_visible = min_visible;
    options.readout = readout;
    options.masks = masks;
    const Camera camera = python::camera(intrinsics, width, height);
    const DepthSigma noise = parse_depth_sigma(depth_sigma);
    if (noise.said()) options.depth_sigma = noise;
    options.check();
    const SessionOptions session{.model = model,
                                 .model_folders = folders,
                                 .device = device,
                                 .solver = device == "cpu" ? Solver::cpu : parse_solver(solver)};
    const auto context = session.solver == Solver::cpu ? nullptr : shared_device(device);
    const Working working;
    tracker_.reset(std::make_unique<Tracker>(Session(session, context), camera, options));
  }

  /// Positions, inverse depths and their sigmas.
  using Given = std::tuple<Points, Vector, Vector>;

  nb::typed<nb::dict, nb::str, nb::any> track(double time, const Array& image, const std::optional<Array>& depth,
                                              const std::optional<Array>& mask, const std::optional<Given>& given) {
    tracker_.check();
    TrackFrame frame{time, image_view(image), {}, {}};
    if (depth) frame.depth = image_view(*depth);
    if (mask) frame.mask = image_view(*mask);
    Features features;
    if (given) {
      const auto& [uv, inverse_depth, sigma] = *given;
      features = python::features(uv, inverse_depth, &sigma);
      frame.features = &features;
    }
    TrackResult r;
    {
      const Working working;
      const auto lock = tracker_.lock();
      r = tracker_.get()->track(frame);
    }
    nb::typed<nb::dict, nb::str, nb::any> out;
    out["time"] = r.time;
    out["status"] = name(r.status);
    out["confirmed"] = r.confirmed;
    out["reason"] = r.reason;
    out["map"] = r.map;
    out["keyframe"] = r.keyframe;
    out["T_CK"] = to_array(r.T_CK);
    out["T_WC"] = to_array(r.T_WC);
    out["covariance"] = to_array(r.covariance);
    out["origin"] = nb::none();
    if (r.origin) out["origin"] = nb::make_tuple(r.origin->keyframe, to_array(r.origin->T_CK), to_array(r.origin->covariance));
    out["before"] = nb::none();
    if (r.before) out["before"] = nb::make_tuple(r.before->keyframe, r.before->time);
    out["features"] = r.features;
    out["visible"] = r.visible;
    out["inliers"] = r.inliers;
    out["sigma"] = r.sigma;
    check_signals();
    return out;
  }

  NewArray<double> keyframe_poses() {
    std::vector<double> poses;
    size_t count = 0;
    {
      const Working working;
      const auto lock = tracker_.lock();
      const Tracker& tracker = *tracker_.get();
      count = static_cast<size_t>(tracker.keyframe_count());
      for (size_t id = 0; id < count; ++id) {
        const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> T = tracker.keyframe_pose(static_cast<int>(id)).matrix();
        poses.insert(poses.end(), T.data(), T.data() + T.size());
      }
    }
    return to_array(poses.data(), {count, 4, 4});
  }

  nb::bytes state() {
    std::vector<uint8_t> bytes;
    {
      const Working working;
      const auto lock = tracker_.lock();
      bytes = tracker_.get()->state();
    }
    return nb::bytes(bytes.data(), bytes.size());
  }

  void restore(const nb::bytes& state, bool starts) {
    const std::span bytes(static_cast<const uint8_t*>(state.data()), state.size());
    const Working working;
    const auto lock = tracker_.lock();
    starts ? tracker_.get()->start_in(bytes) : tracker_.get()->restore(bytes);
  }

 private:
  Owned<Tracker> tracker_{"Tracker"};
};

}  // namespace

void bind_tracker(nb::module_& m) {
  nb::class_<BoundTracker>(m, "Tracker")
      .def(nb::init<const Intrinsics&, int, int, const std::string&, const std::string&, const std::string&,
                    const std::vector<std::string>&, int, int, int, double, double, const std::string&, bool>(),
           nb::arg("intrinsics"), nb::arg("width"), nb::arg("height"), nb::arg("model"), nb::arg("solver"), nb::arg("device"),
           nb::arg("folders"), nb::arg("features"), nb::arg("keyframes"), nb::arg("window"), nb::arg("min_visible"),
           nb::arg("readout"), nb::arg("depth_sigma"), nb::arg("masks"))
      .def("track", &BoundTracker::track, nb::arg("time"), nb::arg("image"), nb::arg("depth").none(), nb::arg("mask").none(),
           nb::arg("features").none())
      .def("keyframe_poses", &BoundTracker::keyframe_poses)
      .def("state", &BoundTracker::state)
      .def("restore", &BoundTracker::restore, nb::arg("state"), nb::arg("starts"));
}

}  // namespace iclk::python
