#pragma once
#include <string>

#include <nlohmann/json.hpp>

#include <iclk/align/model.h>

namespace iclk {

/// Side of the square of input pixels that a pixel of the map of a level depends on.
int receptive_field(const Model& model, int level);
/// The same of the M-estimator's weight, in pixels of its level. 1 without one.
int m_estimator_field(const Model& model);
/// Multiply-accumulates of the M-estimator on a whole level.
double m_estimator_macs(const Model& model, int width, int height);

/// All that is known of a model, for images of one size. Throws Error(invalid_argument) if they are too small for its levels.
nlohmann::ordered_json model_json(const Model& model, int width, int height);
std::string model_table(const Model& model, int width, int height);

}  // namespace iclk
