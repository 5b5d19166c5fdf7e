#include "python/options.h"

#include <cmath>
#include <functional>
#include <map>
#include <optional>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <iclk/engine/error.h>

namespace nb = nanobind;

namespace iclk::python {
namespace {

using Setter = std::function<void(SessionOptions&, nb::handle)>;

template <class T>
Setter into(T& (*member)(SessionOptions&)) {
  return [member](SessionOptions& options, nb::handle value) { member(options) = nb::cast<T>(value); };
}

/// Of a word that `parse` knows.
template <class Parse, class Set>
Setter word(Parse parse, Set set) {
  return [parse, set](SessionOptions& options, nb::handle value) { set(options) = parse(nb::cast<std::string>(value)); };
}

const std::map<std::string, Setter>& setters() {
  static const std::map<std::string, Setter> all = {
      {"model", into<std::string>([](SessionOptions & o) -> auto& { return o.model; })},
      {"damping", word(
                      parse_damping, [](SessionOptions & o) -> auto& { return o.damping; })},
      {"search", word(
                     parse_search, [](SessionOptions & o) -> auto& { return o.search; })},
      {"levels", into<std::optional<int>>([](SessionOptions & o) -> auto& { return o.levels; })},
      {"iterations", into<std::optional<int>>([](SessionOptions & o) -> auto& { return o.iterations; })},
      {"carry", into<std::optional<double>>([](SessionOptions & o) -> auto& { return o.carry; })},
      {"robust", word(
                     parse_robust, [](SessionOptions & o) -> auto& { return o.robust; })},
      {"photometric", into<std::optional<bool>>([](SessionOptions & o) -> auto& { return o.photometric; })},
      {"refine", into<bool>([](SessionOptions & o) -> auto& { return o.refine; })},
      {"refine_rounds", into<int>([](SessionOptions & o) -> auto& { return o.refiner.rounds; })},
      {"structure", into<bool>([](SessionOptions & o) -> auto& { return o.refiner.structure; })},
      {"recolour", into<bool>([](SessionOptions & o) -> auto& { return o.refiner.feature_alignment.recolour; })},
      {"rolling_shutter", into<bool>([](SessionOptions & o) -> auto& { return o.refiner.rolling_shutter; })},
      {"camera_sigma", into<std::optional<double>>([](SessionOptions & o) -> auto& { return o.refiner.pose.camera_sigma; })},
      {"device", into<std::string>([](SessionOptions & o) -> auto& { return o.device; })},
      {"solver", word(
                     parse_solver, [](SessionOptions & o) -> auto& { return o.solver; })},
  };
  return all;
}

}  // namespace

SessionOptions parse_options(const Keywords& keywords, std::vector<std::string> folders) {
  SessionOptions options;
  for (const auto& [key, value] : keywords) {
    const auto name = nb::cast<std::string>(key);
    const auto setter = setters().find(name);
    if (setter == setters().end()) {
      std::string known;
      for (const auto& [other, set] : setters()) known += (known.empty() ? "" : ", ") + other;
      throw nb::type_error(("unknown option '" + name + "'; it must be one of " + known).c_str());
    }
    if (value.is_none()) continue;  // not said
    try {
      setter->second(options, value);
    } catch (const nb::cast_error&) {
      const std::string type = nb::cast<std::string>(nb::str(value.type().attr("__name__")));
      throw nb::type_error((name + " has the wrong type: " + type).c_str());
    }
  }
  if (options.device == "cpu") options.solver = Solver::cpu;
  options.model_folders = std::move(folders);
  return options;
}

}  // namespace iclk::python
