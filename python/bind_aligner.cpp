#include <algorithm>
#include <chrono>
#include <utility>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/engine/error.h>

#include "python/aligner.h"
#include "python/arrays.h"
#include "python/bindings.h"
#include "python/device.h"
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
    if (references < 1 || batch < 1)
      throw Error(ErrorCode::invalid_argument,
                  "references " + std::to_string(references) + " and batch " + std::to_string(batch) + " must be positive");
    const Options parsed = parse_options(options, std::move(folders));
    const auto context = parsed.solver == Solver::cpu ? nullptr : shared_device(parsed.device);
    const Working working;
    aligner_.reset(
        std::make_unique<Aligner>(parsed, Aligner::Sizes{width, height, references, batch, std::max(features, 1)}, context));
  }

  std::vector<std::string> set_reference(int slot, const Array& image, const Points& uv, const Vector& inverse_depth,
                                         const Vector& sigma, const Intrinsics& intrinsics) {
    aligner_.check();
    Reference reference;
    reference.image = image_view(image);
    reference.features = python::features(uv, inverse_depth, &sigma);
    reference.camera = camera(intrinsics, reference.image.width, reference.image.height);
    std::vector<FeatureCheck> checks;
    {
      const Working working;
      const auto lock = aligner_.lock();
      checks = aligner_.get()->set_reference(slot, reference);
    }
    std::vector<std::string> names;
    for (const FeatureCheck check : checks) names.emplace_back(name(check));
    return names;
  }

  nb::typed<nb::list, Fields> align(const std::vector<PairItem>& items) {
    aligner_.check();
    std::vector<Pair> pairs;
    for (const auto& [slot, target, guess, mask] : items) {
      Pair pair{slot, image_view(target), guess ? pose(*guess) : SE3(), {}, !guess};
      if (mask) pair.target_mask = image_view(*mask);
      pairs.push_back(pair);
    }
    // A signal is seen between two batches, of the CPU between two pairs.
    const size_t step = aligner_.get()->on_cpu() ? 1 : static_cast<size_t>(aligner_.get()->sizes().batch);
    nb::typed<nb::list, Fields> out;
    for (size_t first = 0; first < pairs.size(); first += step) {
      const size_t count = std::min(step, pairs.size() - first);
      std::vector<RefinedAlignment> results;
      std::vector<Reference> references;
      {
        const Working working;
        const auto lock = aligner_.lock();
        const auto begin = pairs.begin() + static_cast<std::ptrdiff_t>(first);
        const auto start = std::chrono::steady_clock::now();
        results = aligner_.get()->align({begin, begin + static_cast<std::ptrdiff_t>(count)});
        milliseconds_ += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
        for (size_t i = 0; i < count; ++i) references.push_back(*aligner_.get()->reference(pairs[first + i].reference));
      }
      for (size_t i = 0; i < count; ++i) out.append(to_dict(results[i], references[i]));
      check_signals();
    }
    return out;
  }

  double milliseconds() const { return milliseconds_; }
  std::string device() const {
    aligner_.check();
    return aligner_.get()->device_name();
  }

 private:
  Owned<Aligner> aligner_{"Aligner"};
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
