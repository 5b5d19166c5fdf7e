#include <iclk/align/model/safetensors.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>

#include <iclk/align/common/text.h>
#include <iclk/align/model/json.h>
#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

static_assert(std::endian::native == std::endian::little, "tensors are copied as they lie in the file");

constexpr size_t kMaxHeader = 1 << 18;  // 400 tensors of a model take 50 kB
constexpr size_t kMaxRank = 8, kPrefix = sizeof(uint64_t);

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

struct Entry {
  Safetensors::Tensor tensor;
  size_t begin = 0, end = 0;
};

const Json& member(const Json& entry, const char* key, const std::string& tensor) {
  const Json* found = entry.find(key);
  if (!found) refuse("tensor " + tensor + " has no " + key);
  return *found;
}

Entry parse_entry(const std::string& name, const Json& value, size_t data_size) {
  const std::string shown = in_quotes(name);
  if (value.kind != Json::Kind::object) refuse("tensor " + shown + " is not described by a JSON object");
  if (value.keys.size() != 3) refuse("tensor " + shown + " must have dtype, shape and data_offsets, and nothing else");
  Entry entry;
  entry.tensor.name = name;
  const Json& dtype = member(value, "dtype", shown);
  if (dtype.kind != Json::Kind::string || dtype.string != "F32")
    refuse("tensor " + shown + " has dtype " + in_quotes(dtype.string) +
           "; it must be F32: export the model in single precision");

  const Json& shape = member(value, "shape", shown);
  if (shape.kind != Json::Kind::array || shape.items.size() > kMaxRank)
    refuse("the shape of tensor " + shown + " must be a list of at most " + std::to_string(kMaxRank) + " sizes");
  size_t bytes = sizeof(float);
  for (const Json& item : shape.items) {
    const size_t n = item.integer("a size of tensor " + shown, data_size);
    if (n > 0 && bytes > std::numeric_limits<size_t>::max() / n)
      refuse("the shape of tensor " + shown + " has too many elements");
    bytes *= n;
    entry.tensor.shape.push_back(n);
  }

  const Json& offsets = member(value, "data_offsets", shown);
  if (offsets.kind != Json::Kind::array || offsets.items.size() != 2)
    refuse("data_offsets of tensor " + shown + " must be [begin, end]");
  entry.begin = offsets.items[0].integer("begin of tensor " + shown, data_size);
  entry.end = offsets.items[1].integer("end of tensor " + shown, data_size);
  if (entry.end < entry.begin || entry.end - entry.begin != bytes)
    refuse("tensor " + shown + " of shape " + entry.tensor.shape_text() + " needs " + std::to_string(bytes) +
           " bytes, but its offsets are " + std::to_string(entry.begin) + " to " + std::to_string(entry.end));
  return entry;
}

void parse_metadata(const Json& value, Safetensors& out) {
  if (value.kind != Json::Kind::object) refuse("__metadata__ is not a JSON object");
  for (size_t i = 0; i < value.keys.size(); ++i) {
    if (value.items[i].kind != Json::Kind::string)
      refuse("metadata " + in_quotes(value.keys[i]) + " must be a string, as all metadata in safetensors");
    out.metadata.emplace_back(value.keys[i], value.items[i].string);
  }
}

}  // namespace

std::string Safetensors::Tensor::shape_text() const {
  std::string out;
  for (const size_t n : shape) {
    if (!out.empty()) out += 'x';
    out += std::to_string(n);
  }
  return out.empty() ? "(scalar)" : out;
}

const std::string* Safetensors::find_metadata(std::string_view key) const {
  const auto found = std::find_if(metadata.begin(), metadata.end(), [&](const auto& entry) { return entry.first == key; });
  return found == metadata.end() ? nullptr : &found->second;
}

const Safetensors::Tensor* Safetensors::find(std::string_view name) const {
  const auto found = std::find_if(tensors.begin(), tensors.end(), [&](const Tensor& t) { return t.name == name; });
  return found == tensors.end() ? nullptr : &*found;
}

Safetensors parse_safetensors(std::span<const uint8_t> file) {
  uint64_t header_size = 0;
  if (file.size() < kPrefix) refuse("has " + std::to_string(file.size()) + " bytes, too few for a safetensors file");
  std::memcpy(&header_size, file.data(), kPrefix);
  if (header_size > file.size() - kPrefix)
    refuse("has a header of " + std::to_string(header_size) + " bytes by its length field, but only " +
           std::to_string(file.size() - kPrefix) + " bytes follow: not a safetensors file, or truncated");
  if (header_size > kMaxHeader)
    refuse("has a header of " + std::to_string(header_size) + " bytes, but at most " + std::to_string(kMaxHeader) +
           " are allowed");
  const std::string_view text(reinterpret_cast<const char*>(file.data()) + kPrefix, header_size);
  const std::span<const uint8_t> data = file.subspan(kPrefix + header_size);

  const Json header = parse_json(text, 4);
  if (header.kind != Json::Kind::object) refuse("has a header that is not a JSON object");
  Safetensors out;
  std::vector<Entry> entries;
  for (size_t i = 0; i < header.keys.size(); ++i) {
    if (header.keys[i] == "__metadata__")
      parse_metadata(header.items[i], out);
    else
      entries.push_back(parse_entry(header.keys[i], header.items[i], data.size()));
  }
  // In the order of their bytes, to detect overlaps and gaps: such a file is damaged or hides data.
  std::sort(entries.begin(), entries.end(),
            [](const Entry& a, const Entry& b) { return std::pair(a.begin, a.end) < std::pair(b.begin, b.end); });
  size_t expected = 0;
  for (const Entry& entry : entries) {
    if (entry.begin != expected)
      refuse("tensor " + in_quotes(entry.tensor.name) + " begins at byte " + std::to_string(entry.begin) + " of the data, " +
             (entry.begin < expected ? "inside the tensor before it" : "after a gap") + ", which ends at " +
             std::to_string(expected));
    expected = entry.end;
  }
  if (expected != data.size())
    refuse("has " + std::to_string(data.size()) + " bytes of data, but its tensors describe " + std::to_string(expected));
  for (Entry& entry : entries) {
    entry.tensor.data.resize((entry.end - entry.begin) / sizeof(float));
    if (!entry.tensor.data.empty()) std::memcpy(entry.tensor.data.data(), data.data() + entry.begin, entry.end - entry.begin);
    out.tensors.push_back(std::move(entry.tensor));
  }
  return out;
}

std::vector<uint8_t> safetensors_bytes(const Safetensors& content) {
  std::string header = "{\"__metadata__\":{";
  for (const auto& [key, value] : content.metadata) {
    if (header.back() != '{') header += ',';
    header += json_string(key) + ":" + json_string(value);
  }
  header += "}";
  size_t offset = 0;
  for (const auto& tensor : content.tensors) {
    header += ',';
    header += json_string(tensor.name) + ":{\"dtype\":\"F32\",\"shape\":[";
    for (const size_t n : tensor.shape) {
      if (header.back() != '[') header += ',';
      header += std::to_string(n);
    }
    const size_t end = offset + tensor.data.size() * sizeof(float);
    header += "],\"data_offsets\":[" + std::to_string(offset) + "," + std::to_string(end) + "]}";
    offset = end;
  }
  header += "}";
  header.resize((header.size() + 7) / 8 * 8, ' ');
  std::vector<uint8_t> out(kPrefix + header.size() + offset);
  const uint64_t header_size = header.size();
  std::memcpy(out.data(), &header_size, kPrefix);
  std::memcpy(out.data() + kPrefix, header.data(), header.size());
  uint8_t* to = out.data() + kPrefix + header.size();
  for (const auto& tensor : content.tensors) {
    if (!tensor.data.empty()) std::memcpy(to, tensor.data.data(), tensor.data.size() * sizeof(float));
    to += tensor.data.size() * sizeof(float);
  }
  return out;
}

}  // namespace iclk::internal
