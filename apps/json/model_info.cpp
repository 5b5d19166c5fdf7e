#include "apps/json/model_info.h"

#include <iclk/engine/error.h>
#include <iclk/shaders/shared.h>

#include "apps/json/format.h"

namespace iclk {
namespace {

size_t parameters(const std::vector<ConvLayer>& layers) {
  size_t n = 0;
  for (const ConvLayer& layer : layers) n += layer.weight.size() + layer.bias.size();
  return n;
}

double macs(const std::vector<ConvLayer>& layers, int width, int height) {
  double out = 0;
  for (const ConvLayer& layer : layers) out += 9.0 * layer.in * layer.out * width * height;
  return out;
}

void check_size(const Model& model, int width, int height) {
  const int least = 3 << (model.levels() - 1);  // as Plan::check
  if (width < least || height < least)
    throw Error(ErrorCode::invalid_argument, "--size " + std::to_string(width) + "x" + std::to_string(height) +
                                                 ": the model's " + std::to_string(model.levels()) + " levels need at least " +
                                                 std::to_string(least) + "x" + std::to_string(least));
}

nlohmann::ordered_json layers_json(const std::vector<ConvLayer>& layers) {
  nlohmann::ordered_json out = nlohmann::ordered_json::array();
  for (const ConvLayer& layer : layers) out.push_back({{"in", layer.in}, {"out", layer.out}, {"dilation", layer.dilation}});
  return out;
}

/// "3 > 16 > 32 > 32, dilation 1 2 2"
std::string layers_text(const std::vector<ConvLayer>& layers) {
  std::string out = std::to_string(layers.front().in);
  for (const ConvLayer& layer : layers) out += " > " + std::to_string(layer.out);
  out += ", dilation";
  for (const ConvLayer& layer : layers) out += " " + std::to_string(layer.dilation);
  return out;
}

bool by_image(const Model& model) { return model.normalisation == Normalisation::image; }

std::string channels_text(const Model& model, const std::array<float, 3>& values) {
  std::string out;
  for (int c = 0; c < model.input_channels; ++c) out += formatted(" %.6g", static_cast<double>(values[static_cast<size_t>(c)]));
  return out;
}

}  // namespace

int receptive_field(const Model& model, int level) {
  int field = 1;
  for (int l = 0; l <= level; ++l) {
    if (l > 0) field += 1 << (l - 1);  // the 2x2 mean
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(l)]) field += 2 * layer.dilation << l;
  }
  return field;
}

int m_estimator_field(const Model& model) {
  int field = 1;
  for (const ConvLayer& layer : model.m_estimator) field += 2 * layer.dilation;
  return field;
}

double m_estimator_macs(const Model& model, int width, int height) { return macs(model.m_estimator, width, height); }

nlohmann::ordered_json model_json(const Model& model, int width, int height) {
  check_size(model, width, height);
  nlohmann::ordered_json out;
  out["name"] = model.name;
  out["licence"] = model.licence;
  out["provenance"] = model.provenance;
  out["input_channels"] = model.input_channels;
  out["normalisation"] = by_image(model) ? "image" : "fixed";
  for (const auto& [key, values] : {std::pair("mean", &model.mean), std::pair("std", &model.std)})
    out[key] = std::vector<float>(values->begin(), values->begin() + model.input_channels);
  out["activation"] = "elu";
  out["patch"] = ICLK_PATCH;
  out["iterations"] = model.iterations;
  out["damping"] = model.damping;
  out["carry"] = model.carry;
  out["parameters"] = model.parameters();
  out["bytes"] = model.parameters() * sizeof(float);
  out["width"] = width;
  out["height"] = height;
  out["encoder_gmac"] = model.encoder_macs(width, height, model.levels()) * 1e-9;
  out["levels"] = nlohmann::ordered_json::array();
  for (int l = 0; l < model.levels(); ++l) {
    const auto& layers = model.encoder[static_cast<size_t>(l)];
    out["levels"].push_back({{"level", l},
                             {"width", width >> l},
                             {"height", height >> l},
                             {"layers", layers_json(layers)},
                             {"parameters", parameters(layers)},
                             {"gmac", macs(layers, width >> l, height >> l) * 1e-9},
                             {"receptive_field", receptive_field(model, l)}});
  }
  if (model.m_estimator.empty()) {
    out["m_estimator"] = nullptr;
  } else {
    double all = 0;
    for (int l = 0; l < model.levels(); ++l) all += m_estimator_macs(model, width >> l, height >> l);
    out["m_estimator"] = {{"layers", layers_json(model.m_estimator)},
                          {"parameters", parameters(model.m_estimator)},
                          {"gmac_dense", all * 1e-9},
                          {"receptive_field", m_estimator_field(model)}};
  }
  return out;
}

std::string model_table(const Model& model, int width, int height) {
  check_size(model, width, height);
  const bool colour = model.input_channels == 3;
  std::string out = "name         " + model.name + "\nlicence      " + model.licence + "\nprovenance   " + model.provenance;
  out += "\ninput        " + std::string(colour ? "RGB" : "luma") + (by_image(model) ? " normalised by the image" : "");
  out += ", mean" + channels_text(model, model.mean) + ", std" + channels_text(model, model.std);
  out += formatted("\nmade for     %d levels of %d iterations, damping %g, carry %g, patches of %dx%d\n", model.levels(),
                   model.iterations, model.damping, model.carry, ICLK_PATCH, ICLK_PATCH);
  out += formatted("parameters   %zu (%.2f MB)\n", model.parameters(), static_cast<double>(model.parameters()) * 4e-6);
  out += formatted("\nencoder      ELU; %.3f GMAC an image of %dx%d\n",
                   model.encoder_macs(width, height, model.levels()) * 1e-9, width, height);
  out += "  level       size  parameters    GMAC  receptive field  channels\n";
  for (int l = 0; l < model.levels(); ++l) {
    const auto& layers = model.encoder[static_cast<size_t>(l)];
    const std::string size = std::to_string(width >> l) + "x" + std::to_string(height >> l);
    out += formatted("  %5d  %9s  %10zu  %6.3f  %12d px  ", l, size.c_str(), parameters(layers),
                     macs(layers, width >> l, height >> l) * 1e-9, receptive_field(model, l)) +
           layers_text(layers) + "\n";
  }
  if (model.m_estimator.empty()) return out + "\nM-estimator  none: the weights are 1\n";
  out += formatted("\nM-estimator  %zu parameters; %.3f GMAC on all of level 0; receptive field %d px of each level\n",
                   parameters(model.m_estimator), m_estimator_macs(model, width, height) * 1e-9, m_estimator_field(model));
  return out + "             " + layers_text(model.m_estimator) + "\n";
}

}  // namespace iclk
