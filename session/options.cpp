#include <iclk/session/options.h>

#include <algorithm>
#include <initializer_list>
#include <utility>

#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

template <typename T>
T parse_name(const std::string& name, const char* what, std::initializer_list<std::pair<const char*, T>> known) {
  std::string all;
  for (const auto& [text, value] : known) {
    if (name == text) return value;
    all += (all.empty() ? "" : ", ") + std::string(text);
  }
  throw Error(ErrorCode::invalid_argument,
              std::string(what) + " '" + printable(name) + "' is not known; it must be one of " + all);
}

ModelStage make_stage(const SessionOptions& options, const std::string& name) {
  ModelStage made;
  if (name != "classical") made.model = std::make_shared<Model>(load_model(find_model(name, options.model_folders)));
  AlignerOptions& aligner = made.aligner;
  if (made.model) aligner = made.model->options();
  const bool one_of_several = options.model == "auto" && made.model;  // options unsuitable for it set the classical mode only
  aligner.levels = options.levels.value_or(aligner.levels);
  if (one_of_several) aligner.levels = std::min(aligner.levels, made.model->levels());
  aligner.iterations = options.iterations.value_or(aligner.iterations);
  aligner.carry = options.carry.value_or(aligner.carry);
  if (options.robust && !one_of_several) aligner.robust = *options.robust;
  aligner.damping = options.damping;
  aligner.photometric = options.photometric.value_or(aligner.photometric);
  aligner.search = options.search == SearchMode::automatic ? !options.dense : options.search == SearchMode::on;
  return made;
}

}  // namespace

std::vector<ModelStage> make_stages(const SessionOptions& options) {
  if (!options.stages.empty()) return options.stages;
  if (options.model != "auto") return {make_stage(options, options.model)};
  return {make_stage(options, "classical"), make_stage(options, "sd6dof-small"), make_stage(options, "sd6dof")};
}

std::string model_name(const Model* model) {
  if (model == nullptr) return "classical";
  return model->name.empty() ? "unnamed" : model->name;
}

std::string model_name(const std::vector<ModelStage>& stages) {
  return stages.size() > 1 ? "auto" : model_name(stages.front().model.get());
}

Solver parse_solver(const std::string& name) {
  return parse_name<Solver>(name, "solver", {{"host", Solver::host}, {"device", Solver::device}, {"cpu", Solver::cpu}});
}

SearchMode parse_search(const std::string& name) {
  return parse_name<SearchMode>(name, "search",
                                {{"auto", SearchMode::automatic}, {"on", SearchMode::on}, {"off", SearchMode::off}});
}

Robust parse_robust(const std::string& name) {
  return parse_name<Robust>(
      name, "robust weight",
      {{"unit", Robust::unit}, {"huber", Robust::huber}, {"tukey", Robust::tukey}, {"cauchy", Robust::cauchy}});
}

Damping parse_damping(const std::string& name) {
  return parse_name<Damping>(name, "damping", {{"fixed", Damping::fixed}, {"adaptive", Damping::adaptive}});
}

}  // namespace iclk
