#pragma once
#include <memory>

#include <iclk/align/model.h>

#include "golden.h"

namespace iclk::test {

inline constexpr const char* kLearnedCases[] = {"learned_narrow_188x120", "learned_five_levels_188x120",
                                                "learned_paper_188x120"};

/// The model of a learned golden case. The specification's constants are not in the file: colours and dilations.
inline Model golden_model(const Golden& golden) {
  Model model;
  model.name = "golden";
  model.licence = model.provenance = "random weights";
  model.mean = {0.4914f, 0.4822f, 0.4465f};
  model.std = {0.2023f, 0.1994f, 0.2010f};
  const auto layer = [&](const std::string& name, int dilation) {
    const auto& weight = golden[name + ".weight"];
    return ConvLayer{static_cast<int>(weight.shape[1]), static_cast<int>(weight.shape[0]), dilation, weight.data,
                     golden[name + ".bias"].data};
  };
  for (int n = 0; golden.has("encoder." + std::to_string(n) + ".weight"); ++n) {
    if (n % 3 == 0) model.encoder.emplace_back();
    model.encoder.back().push_back(layer("encoder." + std::to_string(n), n % 3 == 0 ? 1 : 2));
  }
  for (int n = 0; n < 4; ++n) model.m_estimator.push_back(layer("m_estimator." + std::to_string(n), n % 3 == 0 ? 1 : 2 * n));
  return model;
}

/// The specification's settings for it: 10 iterations whatever happens.
inline AlignerOptions golden_options(const Model& model) {
  AlignerOptions options = model.options();
  options.step_tolerance = 0;
  return options;
}

}  // namespace iclk::test
