#pragma once
#include <memory>

#include <iclk/align/model.h>

#include "golden.h"

namespace iclk::test {

/// The model of a learned golden case: three layers a level with dilations 1, 2, 2; M-estimator 1, 2, 4, 1.
inline std::shared_ptr<Model> golden_model(const Golden& golden, int levels, bool m_estimator = true) {
  auto model = std::make_shared<Model>();
  model->mean = {0.4914f, 0.4822f, 0.4465f};
  model->std = {0.2023f, 0.1994f, 0.2010f};
  const auto layer = [&](const std::string& prefix, int number, int dilation) {
    const std::string name = prefix + "." + std::to_string(number);
    const Golden::Tensor& weight = golden[name + ".weight"];
    return ConvLayer{static_cast<int>(weight.shape[1]), static_cast<int>(weight.shape[0]), dilation, weight.data,
                     golden[name + ".bias"].data};
  };
  constexpr int dilations[] = {1, 2, 2}, m_dilations[] = {1, 2, 4, 1};
  for (int l = 0; l < levels; ++l) {
    model->encoder.emplace_back();
    for (int i = 0; i < 3; ++i) model->encoder.back().push_back(layer("encoder", 3 * l + i, dilations[i]));
  }
  for (int i = 0; m_estimator && i < 4; ++i) model->m_estimator.push_back(layer("m_estimator", i, m_dilations[i]));
  return model;
}

}  // namespace iclk::test
