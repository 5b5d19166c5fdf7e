#include <algorithm>
#include <chrono>
#include <span>
#include <utility>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/session/session.h>

#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
#include "python/options.h"
#include "python/results.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

using PairItem = std::tuple<int, Array, std::optional<Pose>, std::optional<Array>>;

/// iclk._core.Aligner.
class BoundAligner {
 public:
  BoundAligner(int width, int height, int references, int batch, int features, const Keywords& options,
               std::vector<std::string> folders) {
    SessionOptions parsed = parse_options(options, std::move(folders));
    parsed.references = references;
    parsed.batch = batch;
    const auto context = parsed.solver == Solver::cpu ? nullptr : shared_device(parsed.device);
    const Working working;
    auto made = std::make_unique<Session>(parsed, context);
    made->expect(width, height, std::max(features, 1));
    session_.reset(std::move(made));
  }

  std::vector<std::string> set_reference(int slot, const Array& image, const Points& uv, const Vector& inverse_depth,
                                         const Vector& sigma, const Intrinsics& intrinsics) {
    session_.check();
    Reference reference;
    reference.image = image_view(image);
    reference.features = python::features(uv, inverse_depth, &sigma);
    reference.camera = camera(intrinsics, reference.image.width, reference.image.height);
    std::vector<FeatureCheck> checks;
    {
      const Working working;
      const auto lock = session_.lock();
      checks = session_.get()->set_reference(slot, reference);
    }
    std::vector<std::string> names;
    for (const FeatureCheck check : checks) names.emplace_back(name(check));
    return names;
  }

  nb::typed<nb::list, Fields> align(const std::vector<PairItem>& items) {
    session_.check();
    std::vector<Pair> pairs;
    for (const auto& [slot, target, guess, mask] : items) {
      Pair pair{slot, image_view(target), guess ? pose(*guess) : SE3(), {}, !guess};
      if (mask) pair.target_mask = image_view(*mask);
      pairs.push_back(pair);
    }
    // A signal is seen between two batches, of the CPU between two pairs.
    const Session& session = *session_.get();
    const size_t step = session.context() ? static_cast<size_t>(session.options().batch) : 1;
    nb::typed<nb::list, Fields> out;
    for (size_t first = 0; first < pairs.size(); first += step) {
      const size_t count = std::min(step, pairs.size() - first);
      std::vector<RefinedAlignment> results;
      std::vector<Reference> references;
      {
        const Working working;
        const auto lock = session_.lock();
        const auto start = std::chrono::steady_clock::now();
        results = session_.get()->align(std::span<const Pair>(pairs).subspan(first, count));
        milliseconds_ += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
        for (size_t i = 0; i < count; ++i) references.push_back(*session.reference(pairs[first + i].reference));
      }
      for (size_t i = 0; i < count; ++i) out.append(to_dict(results[i], references[i]));
      check_signals();
    }
    return out;
  }

  double milliseconds() const { return milliseconds_; }
  std::string device() const {
    session_.check();
    return session_.get()->device_name();
  }

 private:
  Owned<Session> session_{"Aligner"};
  double milliseconds_ = 0;  // in the alignment itself, of all calls
};

}  // namespace

void bind_aligner(nb::module_& m) {
  nb::class_<BoundAligner>(m, "Aligner")
      .def(nb::init<int, int, int, int, int, const Keywords&, std::vector<std::string>>(), nb::arg("width"), nb::arg("height"),
           nb::arg("references"), nb::arg("batch"), nb::arg("features"), nb::arg("options"), nb::arg("folders"))
      .def("set_reference", &BoundAligner::set_reference, nb::arg("slot"), nb::arg("image"), nb::arg("uv"),
           nb::arg("inverse_depth"), nb::arg("sigma"), nb::arg("intrinsics"))
      .def("align", &BoundAligner::align, nb::arg("pairs"))
      .def_prop_ro("device", &BoundAligner::device)
      .def_prop_ro("milliseconds", &BoundAligner::milliseconds);
}

}  // namespace iclk::python
