#pragma once
// Converts the state of a tracker to bytes and back. One function lists the members, for both writing and reading. The byte
// order is that of the machine, because a state continues a stopped run and is not a file format.
#include <cstring>
#include <map>
#include <optional>
#include <span>
#include <type_traits>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/se3.h>
#include <iclk/engine/error.h>

namespace iclk::internal {

template <class T>
concept Plain = std::is_arithmetic_v<T> || std::is_enum_v<T>;

class Writer {
 public:
  static constexpr bool kReads = false;
  std::vector<uint8_t> bytes;

  void raw(void* data, size_t size) {
    const auto* from = static_cast<const uint8_t*>(data);
    bytes.insert(bytes.end(), from, from + size);
  }
  size_t left() const { return 0; }
};

class Reader {
 public:
  static constexpr bool kReads = true;
  explicit Reader(std::span<const uint8_t> bytes) : bytes_(bytes) {}

  void raw(void* data, size_t size) {
    if (size > bytes_.size()) throw Error(ErrorCode::invalid_argument, "the saved tracker state is truncated");
    if (size > 0) std::memcpy(data, bytes_.data(), size);
    bytes_ = bytes_.subspan(size);
  }
  size_t left() const { return bytes_.size(); }

 private:
  std::span<const uint8_t> bytes_;
};

/// archive(stream, value) writes or reads plain values, types of Eigen, and containers of these. Other types define their own
/// overload.
template <class Stream, Plain T>
void archive(Stream& s, T& value) {
  s.raw(&value, sizeof(T));
}

template <class Stream>
void archive(Stream& s, bool& value) {
  auto byte = static_cast<uint8_t>(value);
  s.raw(&byte, 1);
  value = byte != 0;
}

template <class Stream, class T, int R, int C, int O>
void archive(Stream& s, Eigen::Matrix<T, R, C, O>& m) {
  static_assert(R > 0 && C > 0);
  s.raw(m.data(), sizeof(T) * R * C);
}

template <class Stream>
void archive(Stream& s, SE3& T) {
  archive(s, T.R);
  archive(s, T.t);
}

/// The length of a container. Each element needs at least one byte, so a damaged length cannot allocate all memory.
template <class Stream>
size_t archive_size(Stream& s, size_t size) {
  uint64_t n = size;
  archive(s, n);
  if (Stream::kReads && n > s.left()) throw Error(ErrorCode::invalid_argument, "the saved tracker state is truncated");
  return static_cast<size_t>(n);
}

template <class Stream, class T>
void archive(Stream& s, std::vector<T>& values) {
  const size_t n = archive_size(s, values.size());
  if constexpr (Plain<T>) {
    if (Stream::kReads && n > s.left() / sizeof(T))
      throw Error(ErrorCode::invalid_argument, "the saved tracker state is truncated");
    if constexpr (Stream::kReads) values.resize(n);
    s.raw(values.data(), n * sizeof(T));
  } else {
    if constexpr (Stream::kReads) values = std::vector<T>(n);
    for (T& value : values) archive(s, value);
  }
}

template <class Stream, class T>
void archive(Stream& s, std::optional<T>& value) {
  bool has = value.has_value();
  archive(s, has);
  if constexpr (Stream::kReads) value = has ? std::optional<T>(T{}) : std::nullopt;
  if (value) archive(s, *value);
}

template <class Stream, class K, class T>
void archive(Stream& s, std::map<K, T>& values) {
  const size_t n = archive_size(s, values.size());
  if constexpr (Stream::kReads) {
    values.clear();
    for (size_t i = 0; i < n; ++i) {
      K key{};
      archive(s, key);
      archive(s, values[key]);
    }
  } else {
    for (auto& [key, value] : values) {
      K copy = key;
      archive(s, copy);
      archive(s, value);
    }
  }
}

template <class Stream, class... Ts>
void archive_all(Stream& s, Ts&... values) {
  (archive(s, values), ...);
}

}  // namespace iclk::internal
