#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <iclk/align/model.h>

namespace iclk {

/// A model is a safetensors file. Tensors, all F32, layers numbered through all levels, batch normalisation folded in:
///   encoder.N.weight (out, in, 3, 3), encoder.N.bias (out), and the same for m_estimator.N; no others.
/// Metadata, all text as safetensors wants it:
///   format               iclk-model-1
///   name, licence, provenance
///   encoder_channels     [[16,32,32],[32,64,64]]: channels that each layer gives, a list a level, finest first
///   encoder_dilations    [[1,2,2],[1,2,2]]
///   m_estimator_channels, m_estimator_dilations    [16,32,64,1], [1,2,4,1]; both absent: no M-estimator
///   input_channels       3 (RGB) or 1 (luma)
///   normalisation        fixed, or image: see Normalisation; absent: fixed
///   mean, std            [0.49,0.48,0.45]: one a channel, of pixels in [0, 1] or of the normalised image
///   activation           elu
///   patch                8: pixels of a feature's patch, one way
///   iterations, damping, carry    with which it is meant to be run; carry absent: 0
/// Other metadata are left alone.

/// Throws Error(io) if the file cannot be read, Error(invalid_argument) if it is no model: the message names the file, what is
/// wrong, and what it must be.
Model load_model(const std::string& path);

/// The same for bytes in memory; `name` stands for the file in messages.
Model parse_model(std::span<const uint8_t> bytes, const std::string& name);

/// The file that parse_model reads. Throws Error(invalid_argument) for a model that cannot be.
std::vector<uint8_t> model_bytes(const Model& model);

/// Writes the file whole or not at all. Throws as model_bytes, and Error(io).
void save_model(const Model& model, const std::string& path);

}  // namespace iclk
