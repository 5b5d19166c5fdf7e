#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/options.h>

#include "apps/session/model_lookup.h"

namespace iclk {

/// A model, and how to align with it.
struct ModelStage {
  AlignerOptions aligner;
  std::shared_ptr<const Model> model;  ///< null: the classical mode
};

/// How to align, as a person says it. What has no value is the model's, or the classical mode's.
struct AlignmentWish {
  std::string model = default_model(), precision = "fp32", damping = "fixed", search = "auto";
  std::optional<int> levels, iterations;
  std::optional<double> lambda, carry;
  std::optional<std::string> robust;
  std::optional<bool> photometric;
  StartSearch start_search;
  double search_rotation = 0;  ///< degrees
  bool dense = false;

  /// The models in the order in which a Cascade asks them, one unless `model` is auto; reads their files. `guessed`: the pairs
  /// come with a first guess, about which nothing is searched unless `search` is on. Throws Error(invalid_argument) that names
  /// the value, Error(io) for a model that is not there.
  std::vector<ModelStage> stages(bool guessed, const std::vector<std::string>& folders = model_folders()) const;
};

/// Throws Error(invalid_argument) that lists the names.
Solver parse_solver(const std::string& name);
Robust parse_robust(const std::string& name);
Precision parse_precision(const std::string& name);
Damping parse_damping(const std::string& name);

}  // namespace iclk
