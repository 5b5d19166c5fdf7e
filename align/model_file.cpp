#include <iclk/align/model_file.h>

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numeric>

#include <iclk/align/common/text.h>
#include <iclk/align/model/json.h>
#include <iclk/align/model/model_check.h>
#include <iclk/align/model/safetensors.h>
#include <iclk/engine/error.h>
#include <iclk/shaders/shared.h>

namespace iclk {
namespace {

using internal::in_quotes;
using internal::Json;
using internal::Safetensors;

constexpr size_t kMaxFile = internal::kMaxModelParameters * sizeof(float) + (1 << 20);
constexpr const char* kFormat = "iclk-model-1";

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

const std::string& text(const Safetensors& file, const char* key) {
  const std::string* found = file.find_metadata(key);
  if (!found)
    refuse(std::string("metadata '") + key +
           "' is missing; export the model again with the metadata that align/model_file.h lists");
  return *found;
}

void need(const Safetensors& file, const char* key, const std::string& value) {
  if (text(file, key) != value) refuse(std::string(key) + " is " + in_quotes(text(file, key)) + ", must be '" + value + "'");
}

/// A name or a sentence without control characters; JSON guarantees UTF-8.
std::string plain_text(const Safetensors& file, const char* key) {
  const std::string& value = text(file, key);
  const auto control = [](unsigned char c) { return c < 0x20 || c == 0x7f; };
  if (value.empty() || value.size() > 4000 || std::any_of(value.begin(), value.end(), control))
    refuse(std::string(key) + " must be 1 to 4000 bytes of text without control characters");
  return value;
}

Json json(const Safetensors& file, const char* key) {
  try {
    return internal::parse_json(text(file, key), 2);
  } catch (const Error& e) {
    refuse(std::string("metadata '") + key + "': " + e.what());
  }
}

double number(const Json& value, const char* key) {
  if (value.kind != Json::Kind::number) refuse(std::string("metadata '") + key + "' must have numbers");
  return value.number;
}

std::array<float, 3> channel_values(const Safetensors& file, const char* key, int channels, float rest) {
  const Json list = json(file, key);
  if (list.kind != Json::Kind::array || list.items.size() != static_cast<size_t>(channels))
    refuse(std::string("metadata '") + key + "' must be a list of " + std::to_string(channels) + ", one per channel");
  std::array<float, 3> out{rest, rest, rest};
  for (size_t c = 0; c < list.items.size(); ++c) out[c] = static_cast<float>(number(list.items[c], key));
  return out;
}

std::vector<int> sizes(const Json& list, const char* key, int most) {
  if (list.kind != Json::Kind::array || list.items.empty() || list.items.size() > internal::kMaxLevelLayers)
    refuse(std::string("metadata '") + key + "' must have lists of 1 to " + std::to_string(internal::kMaxLevelLayers) +
           " numbers, one per layer");
  std::vector<int> out;
  for (const Json& item : list.items) out.push_back(static_cast<int>(item.integer(key, static_cast<size_t>(most))));
  return out;
}

std::vector<std::vector<int>> level_sizes(const Safetensors& file, const char* key, int most) {
  const Json list = json(file, key);
  if (list.kind != Json::Kind::array || list.items.empty() || list.items.size() > internal::kMaxModelLevels)
    refuse(std::string("metadata '") + key + "' must be a list of 1 to " + std::to_string(internal::kMaxModelLevels) +
           " lists, one per level");
  std::vector<std::vector<int>> out;
  for (const Json& item : list.items) out.push_back(sizes(item, key, most));
  return out;
}

/// Reads the layers of one of the two networks from the file, in order.
class Layers {
 public:
  Layers(Safetensors& file, std::string network) : file_(&file), network_(std::move(network)) {}

  std::vector<ConvLayer> take(int in, const std::vector<int>& channels, const std::vector<int>& dilations) {
    if (channels.size() != dilations.size())
      refuse(network_ + "_channels and " + network_ + "_dilations must have the same lengths");
    std::vector<ConvLayer> out;
    for (size_t i = 0; i < channels.size(); ++i) {
      ConvLayer layer{in, channels[i], dilations[i], {}, {}};
      const auto from = static_cast<size_t>(in), to = static_cast<size_t>(layer.out);
      const std::string name = network_ + "." + std::to_string(next_++);
      layer.weight = take(name + ".weight", {to, from, 3, 3});
      layer.bias = take(name + ".bias", {to});
      in = layer.out;
      out.push_back(std::move(layer));
    }
    return out;
  }

 private:
  std::vector<float> take(const std::string& name, const std::vector<size_t>& shape) {
    const Safetensors::Tensor expected{name, shape, {}};
    const auto found =
        std::find_if(file_->tensors.begin(), file_->tensors.end(), [&](const auto& t) { return t.name == name; });
    if (found == file_->tensors.end()) refuse("tensor '" + name + "' of shape " + expected.shape_text() + " is missing");
    if (found->shape != shape)
      refuse("tensor '" + name + "' has the shape " + found->shape_text() + ", but the architecture needs " +
             expected.shape_text());
    std::vector<float> data = std::move(found->data);
    file_->tensors.erase(found);
    return data;
  }

  Safetensors* file_;
  std::string network_;
  int next_ = 0;
};

Model to_model(Safetensors file) {
  need(file, "format", kFormat);
  need(file, "activation", "elu");
  need(file, "patch", std::to_string(ICLK_PATCH));
  Model model;
  model.name = plain_text(file, "name");
  model.licence = plain_text(file, "licence");
  model.provenance = plain_text(file, "provenance");
  model.input_channels = static_cast<int>(json(file, "input_channels").integer("input_channels", 3));
  if (model.input_channels != 1 && model.input_channels != 3) refuse("input_channels must be 3 (RGB) or 1 (luma)");
  if (const std::string* normalisation = file.find_metadata("normalisation")) {
    if (*normalisation != "fixed" && *normalisation != "image")
      refuse("normalisation is " + in_quotes(*normalisation) + ", must be fixed or image");
    if (*normalisation == "image") model.normalisation = Normalisation::image;
  }
  model.mean = channel_values(file, "mean", model.input_channels, 0);
  model.std = channel_values(file, "std", model.input_channels, 1);
  model.iterations = static_cast<int>(json(file, "iterations").integer("iterations", 100));
  model.damping = number(json(file, "damping"), "damping");
  if (file.find_metadata("carry")) model.carry = number(json(file, "carry"), "carry");

  const auto channels = level_sizes(file, "encoder_channels", internal::kMaxChannels);
  const auto dilations = level_sizes(file, "encoder_dilations", internal::kMaxDilation);
  if (channels.size() != dilations.size())
    refuse("encoder_channels has " + std::to_string(channels.size()) + " levels, encoder_dilations " +
           std::to_string(dilations.size()));
  Layers encoder(file, "encoder");
  int in = model.input_channels;
  for (size_t level = 0; level < channels.size(); ++level) {
    model.encoder.push_back(encoder.take(in, channels[level], dilations[level]));
    in = channels[level].back();
  }
  if (file.find_metadata("m_estimator_channels") || file.find_metadata("m_estimator_dilations"))
    model.m_estimator = Layers(file, "m_estimator")
                            .take(4, sizes(json(file, "m_estimator_channels"), "m_estimator_channels", internal::kMaxChannels),
                                  sizes(json(file, "m_estimator_dilations"), "m_estimator_dilations", internal::kMaxDilation));
  if (!file.tensors.empty())
    refuse("tensor " + in_quotes(file.tensors.front().name) + " belongs to none of the layers in the metadata");
  internal::check_model(model);
  return model;
}

template <class Items, class Text>
std::string list(const Items& items, Text&& text) {
  std::string out = "[";
  for (const auto& item : items) {
    if (out.size() > 1) out += ",";
    out += text(item);
  }
  return out + "]";
}

std::string values(const std::array<float, 3>& all, int channels) {
  return list(std::span(all).first(static_cast<size_t>(channels)), [](float x) { return internal::exact_text(x); });
}

std::string layers(const std::vector<ConvLayer>& all, int ConvLayer::*member) {
  return list(all, [&](const ConvLayer& layer) { return std::to_string(layer.*member); });
}

std::string levels(const std::vector<std::vector<ConvLayer>>& all, int ConvLayer::*member) {
  return list(all, [&](const std::vector<ConvLayer>& level) { return layers(level, member); });
}

}  // namespace

Model parse_model(std::span<const uint8_t> bytes, const std::string& name) {
  try {
    return to_model(internal::parse_safetensors(bytes));
  } catch (const Error& e) {
    throw Error(e.code(), "model " + name + ": " + e.what());
  }
}

Model load_model(const std::string& path) {
  const auto fail = [&](const std::string& why) { throw Error(ErrorCode::io, "cannot read the model " + path + ": " + why); };
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (error || !std::filesystem::exists(status)) fail(error ? error.message() : std::strerror(ENOENT));
  if (!std::filesystem::is_regular_file(status)) fail("it is not a file");
  const uintmax_t size = std::filesystem::file_size(path, error);
  if (error) fail(error.message());
  if (size > kMaxFile)
    throw Error(ErrorCode::invalid_argument, "model " + path + ": has " + std::to_string(size) + " bytes, but at most " +
                                                 std::to_string(kMaxFile) + " are allowed");
  std::ifstream file(path, std::ios::binary);
  if (!file) fail(std::strerror(errno));
  std::vector<uint8_t> bytes(static_cast<size_t>(size));
  file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  if (file.bad() || static_cast<size_t>(file.gcount()) != bytes.size()) fail("the file is truncated");
  return parse_model(bytes, path);
}

std::vector<uint8_t> model_bytes(const Model& model) {
  internal::check_model(model);
  Safetensors file;
  file.metadata = {{"format", kFormat},
                   {"name", model.name},
                   {"licence", model.licence},
                   {"provenance", model.provenance},
                   {"input_channels", std::to_string(model.input_channels)},
                   {"mean", values(model.mean, model.input_channels)},
                   {"std", values(model.std, model.input_channels)},
                   {"activation", "elu"},
                   {"patch", std::to_string(ICLK_PATCH)},
                   {"iterations", std::to_string(model.iterations)},
                   {"damping", internal::exact_text(model.damping)},
                   {"encoder_channels", levels(model.encoder, &ConvLayer::out)},
                   {"encoder_dilations", levels(model.encoder, &ConvLayer::dilation)}};
  if (model.carry != 0) file.metadata.emplace_back("carry", internal::exact_text(model.carry));
  if (model.normalisation == Normalisation::image) file.metadata.emplace_back("normalisation", "image");
  int n = 0;
  const auto add = [&](const std::string& network, const ConvLayer& layer) {
    const std::string name = network + "." + std::to_string(n++);
    const auto in = static_cast<size_t>(layer.in), out = static_cast<size_t>(layer.out);
    file.tensors.push_back({name + ".weight", {out, in, 3, 3}, layer.weight});
    file.tensors.push_back({name + ".bias", {out}, layer.bias});
  };
  for (const auto& level : model.encoder)
    for (const ConvLayer& layer : level) add("encoder", layer);
  if (!model.m_estimator.empty()) {
    file.metadata.emplace_back("m_estimator_channels", layers(model.m_estimator, &ConvLayer::out));
    file.metadata.emplace_back("m_estimator_dilations", layers(model.m_estimator, &ConvLayer::dilation));
    n = 0;
    for (const ConvLayer& layer : model.m_estimator) add("m_estimator", layer);
  }
  return internal::safetensors_bytes(file);
}

void save_model(const Model& model, const std::string& path) {
  const std::vector<uint8_t> bytes = model_bytes(model);
  const std::string temporary = path + ".part" + std::to_string(::getpid());
  std::ofstream file(temporary, std::ios::binary | std::ios::trunc);
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  file.close();
  const bool written = static_cast<bool>(file) && std::rename(temporary.c_str(), path.c_str()) == 0;
  if (written) return;
  const int error = errno;
  std::remove(temporary.c_str());
  throw Error(ErrorCode::io, "cannot write the model " + path + ": " + std::strerror(error));
}

}  // namespace iclk
