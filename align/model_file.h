#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <iclk/align/model.h>

namespace iclk {

/// Loads a model from a safetensors file. Throws Error(io) if the file cannot be read, Error(invalid_argument) if it is not a
/// valid model: the message names the file, the wrong value and the allowed ones.
///
/// The tensors are F32, with batch normalisation folded in. Layers are numbered through all levels:
///
///     encoder.N.weight (out, in, 3, 3), encoder.N.bias (out), and the same for m_estimator.N; no others
///
/// Metadata values are text, as safetensors requires. Other keys are ignored.
///
///     format               iclk-model-1
///     name, licence, provenance
///     encoder_channels     [[16,32,32],[32,64,64]]: output channels of each layer, one list per level, finest first
///     encoder_dilations    [[1,2,2],[1,2,2]]
///     m_estimator_channels, m_estimator_dilations    [16,32,64,1], [1,2,4,1]; both absent: no M-estimator
///     input_channels       3 (RGB) or 1 (luma)
///     normalisation        fixed or image: see Normalisation; absent: fixed
///     mean, std            [0.49,0.48,0.45]: one per channel, of pixels in [0, 1] or of the normalised image
///     activation           elu
///     patch                8: width and height of a feature's patch, pixels
///     iterations, damping, carry    recommended AlignerOptions; carry absent: 0
Model load_model(const std::string& path);

/// Like load_model(), for bytes in memory; messages call the file `name`.
Model parse_model(std::span<const uint8_t> bytes, const std::string& name);

/// The contents of the file that parse_model() reads. Throws Error(invalid_argument) for an invalid model.
std::vector<uint8_t> model_bytes(const Model& model);

/// Writes the file completely or not at all. Throws the errors of model_bytes(), and Error(io).
void save_model(const Model& model, const std::string& path);

}  // namespace iclk
