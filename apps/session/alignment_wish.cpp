#include "apps/session/alignment_wish.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <utility>

#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>

#include "apps/io/text.h"

namespace iclk {
namespace {

template <typename T>
T parse_name(const std::string& name, const char* what, std::initializer_list<std::pair<const char*, T>> known) {
  std::string all;
  for (const auto& [text, value] : known) {
    if (name == text) return value;
    all += (all.empty() ? "" : ", ") + std::string(text);
  }
  throw Error(ErrorCode::invalid_argument, std::string(what) + " '" + printable(name) + "' is not known: one of " + all);
}

}  // namespace

Solver parse_solver(const std::string& name) {
  return parse_name<Solver>(name, "solver", {{"host", Solver::host}, {"device", Solver::device}, {"cpu", Solver::cpu}});
}

Robust parse_robust(const std::string& name) {
  return parse_name<Robust>(
      name, "robust weight",
      {{"unit", Robust::unit}, {"huber", Robust::huber}, {"tukey", Robust::tukey}, {"cauchy", Robust::cauchy}});
}

Precision parse_precision(const std::string& name) {
  return parse_name<Precision>(name, "precision", {{"fp32", Precision::fp32}, {"fp16", Precision::fp16}});
}

Damping parse_damping(const std::string& name) {
  return parse_name<Damping>(name, "damping", {{"fixed", Damping::fixed}, {"adaptive", Damping::adaptive}});
}

std::vector<ModelStage> AlignmentWish::stages(bool guessed, const std::vector<std::string>& folders) const {
  if (search != "auto" && search != "on" && search != "rotations" && search != "off")
    throw Error(ErrorCode::invalid_argument,
                "search '" + printable(search) + "' is not known: one of auto, on, rotations, off");
  const auto stage = [&](const std::string& name) {
    ModelStage made;
    if (name != "classical") made.model = std::make_shared<Model>(load_model(find_model(name, folders)));
    if (made.model) made.aligner = made.model->options();
    const bool one_of_several = model == "auto" && made.model;  // options that it cannot take are the classical mode's
    made.aligner.levels = levels.value_or(made.aligner.levels);
    if (one_of_several) made.aligner.levels = std::min(made.aligner.levels, made.model->levels());
    made.aligner.iterations = iterations.value_or(made.aligner.iterations);
    made.aligner.lambda = lambda.value_or(made.aligner.lambda);
    made.aligner.carry = carry.value_or(made.aligner.carry);
    if (robust && !one_of_several) made.aligner.robust = parse_robust(*robust);
    made.aligner.damping = parse_damping(damping);
    made.aligner.precision = parse_precision(precision);
    made.aligner.photometric = photometric.value_or(made.aligner.photometric);
    made.aligner.search = start_search;
    made.aligner.search.matching = search != "rotations";
    made.aligner.search.enabled = search == "on" || search == "rotations" || (search == "auto" && !guessed && !dense);
    made.aligner.search.rotation = search_rotation * M_PI / 180;
    return made;
  };
  if (model != "auto") return {stage(model)};
  return {stage("classical"), stage("sd6dof-small"), stage("sd6dof")};
}

}  // namespace iclk
