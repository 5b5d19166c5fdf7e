#include "python/options.h"

#include <functional>
#include <map>
#include <optional>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <iclk/engine/error.h>

namespace nb = nanobind;

namespace iclk::python {
namespace {

using Setter = std::function<void(Options&, nb::handle)>;

template <class T>
Setter into(T& (*member)(Options&)) {
  return [member](Options& options, nb::handle value) { member(options) = nb::cast<T>(value); };
}

const std::map<std::string, Setter>& setters() {
  static const std::map<std::string, Setter> all = {
      {"model", into<std::string>([](Options & o) -> auto& { return o.wish.model; })},
      {"precision", into<std::string>([](Options & o) -> auto& { return o.wish.precision; })},
      {"damping", into<std::string>([](Options & o) -> auto& { return o.wish.damping; })},
      {"search", into<std::string>([](Options & o) -> auto& { return o.wish.search; })},
      {"search_rotation", into<double>([](Options & o) -> auto& { return o.wish.search_rotation; })},
      {"levels", into<std::optional<int>>([](Options & o) -> auto& { return o.wish.levels; })},
      {"iterations", into<std::optional<int>>([](Options & o) -> auto& { return o.wish.iterations; })},
      {"damping_lambda", into<std::optional<double>>([](Options & o) -> auto& { return o.wish.lambda; })},
      {"carry", into<std::optional<double>>([](Options & o) -> auto& { return o.wish.carry; })},
      {"robust", into<std::optional<std::string>>([](Options & o) -> auto& { return o.wish.robust; })},
      {"photometric", into<std::optional<bool>>([](Options & o) -> auto& { return o.wish.photometric; })},
      {"refine", into<bool>([](Options & o) -> auto& { return o.refine; })},
      {"refine_rounds", into<int>([](Options & o) -> auto& { return o.refiner.rounds; })},
      {"structure", into<bool>([](Options & o) -> auto& { return o.refiner.structure; })},
      {"recolour", into<bool>([](Options & o) -> auto& { return o.refiner.feature_alignment.recolour; })},
      {"rolling_shutter", into<bool>([](Options & o) -> auto& { return o.refiner.rolling_shutter; })},
      {"camera_sigma", into<std::optional<double>>([](Options & o) -> auto& { return o.refiner.pose.camera_sigma; })},
      {"device", into<std::string>([](Options & o) -> auto& { return o.device; })},
      {"solver", [](Options& o, nb::handle value) { o.solver = parse_solver(nb::cast<std::string>(value)); }},
  };
  return all;
}

}  // namespace

Options parse_options(const Keywords& keywords, std::vector<std::string> folders) {
  Options options;
  for (const auto& [key, value] : keywords) {
    const auto name = nb::cast<std::string>(key);
    const auto setter = setters().find(name);
    if (setter == setters().end()) {
      std::string known;
      for (const auto& [other, set] : setters()) known += (known.empty() ? "" : ", ") + other;
      throw nb::type_error(("there is no option '" + name + "': one of " + known).c_str());
    }
    if (value.is_none()) continue;  // not said
    try {
      setter->second(options, value);
    } catch (const nb::cast_error&) {
      const std::string type = nb::cast<std::string>(nb::str(value.type().attr("__name__")));
      throw nb::type_error((name + " is of the wrong type: " + type).c_str());
    }
  }
  if (options.device == "cpu") options.solver = Solver::cpu;
  options.folders = std::move(folders);
  return options;
}

}  // namespace iclk::python
