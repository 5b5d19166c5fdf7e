#include <iclk/align/tuning.h>

#include <algorithm>
#include <set>
#include <sstream>

#include <iclk/align/network/convolution.h>
#include <iclk/align/network/tiling.h>

namespace iclk {
namespace {

constexpr std::string_view kHeader = "iclk-tuning 5";
std::optional<ConvVariant> variant_of(std::string_view word) {
  for (ConvVariant variant : kConvVariants)
    if (word == name(variant)) return variant;
  return {};
}

std::string checksum(std::string_view text) {
  uint64_t hash = 0xcbf29ce484222325u;  // FNV-1a
  for (char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  std::ostringstream out;
  out << std::hex << hash;
  return out.str();
}

}  // namespace

const char* name(ConvVariant variant) {
  constexpr const char* names[] = {"direct", "winograd4", "winograd4x1"};
  return names[static_cast<int>(variant)];
}

// The numbers are of lavapipe (docs/convolutions.md). Transforms of whole tiles are paid once a layer: they pay where many
// products follow, and where there are tiles enough that threads need not transform the same ones.
ConvVariant usual_variant(const ConvShape& shape, engine::DeviceType type) {
  if (type != engine::DeviceType::cpu) return ConvVariant::direct;
  const int64_t in = shape.in, products = in * shape.out, input = in * shape.width * shape.height;
  return products >= 512 && input >= 50'000 ? ConvVariant::winograd4 : ConvVariant::winograd4x1;
}

ConvVariant Tuning::choose(const ConvShape& shape, engine::DeviceType type) const {
  const auto found = variants.find(shape);
  return found != variants.end() ? found->second : usual_variant(shape, type);
}

std::string Tuning::text(std::string_view key) const {
  std::ostringstream out;
  out << kHeader << "\n" << key << "\n" << variants.size() << "\n";
  for (const auto& [s, variant] : variants)
    out << s.in << " " << s.out << " " << s.dilation << " " << s.width << " " << s.height << " " << s.last << " "
        << name(variant) << "\n";
  const std::string body = out.str();
  return body + checksum(body) + "\n";
}

std::optional<Tuning> Tuning::parse(std::string_view text, std::string_view key) {
  std::istringstream in{std::string(text)};
  std::string line, word;
  if (!std::getline(in, line) || line != kHeader || !std::getline(in, line) || line != key) return {};
  Tuning tuning;
  size_t count = 0;
  if (!(in >> count)) return {};
  for (size_t i = 0; i < count; ++i) {
    ConvShape s;
    if (!(in >> s.in >> s.out >> s.dilation >> s.width >> s.height >> s.last >> word)) return {};
    const auto variant = variant_of(word);
    if (!variant) return {};
    tuning.variants[s] = *variant;
  }
  if (tuning.text(key) != text) return {};  // the checksum, and anything after it
  return tuning;
}

std::string tuning_key(const engine::Context& context) {
  std::ostringstream out;
  out << engine::uuid_text(context.info().uuid) << "-" << std::hex << context.info().driver_version << "-"
      << internal::conv_shader_hash() << (internal::can_shuffle(context.info()) ? "" : "-plain");
  return out.str();
}

std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels) {
  levels = std::min(levels, model.levels());
  const internal::Tiling tiling(model, static_cast<uint32_t>(width), static_cast<uint32_t>(height), levels);
  std::set<ConvShape> shapes;
  for (int l = 0; l < levels; ++l)
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(l)])
      shapes.insert({layer.in, layer.out, layer.dilation, static_cast<int>(tiling.width >> l),
                     static_cast<int>(tiling.height >> l), &layer == &model.encoder[static_cast<size_t>(l)].back()});
  return {shapes.begin(), shapes.end()};
}

}  // namespace iclk
