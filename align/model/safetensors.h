#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace iclk::internal {

/// The contents of a safetensors file: a little-endian 64-bit header size, a JSON header
/// `{"NAME": {"dtype", "shape", "data_offsets"}, ..., "__metadata__": {"KEY": "TEXT", ...}}` padded with blanks, then the bytes
/// of the tensors without gaps. Single precision only.
struct Safetensors {
  struct Tensor {
    std::string name;
    std::vector<size_t> shape;
    std::vector<float> data;  ///< row-major

    std::string shape_text() const;  ///< for example "16x3x3x3"
  };
  std::vector<std::pair<std::string, std::string>> metadata;
  std::vector<Tensor> tensors;

  const std::string* find_metadata(std::string_view key) const;  ///< null: no such entry
  const Tensor* find(std::string_view name) const;               ///< null: no such tensor
};

/// Parses a file; checks every size and offset against the number of bytes. Throws Error(invalid_argument).
Safetensors parse_safetensors(std::span<const uint8_t> file);
std::vector<uint8_t> safetensors_bytes(const Safetensors& content);

}  // namespace iclk::internal
