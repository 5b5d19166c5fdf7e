#include "apps/iclk/io/image_header.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <iclk/session/io/text.h>

namespace iclk {
namespace {

using namespace std::string_view_literals;
using Header = std::optional<ImageHeader>;

constexpr std::string_view kJpeg = "\xff\xd8\xff"sv, kPng = "\x89PNG\r\n\x1a\n"sv, kExr = "\x76\x2f\x31\x01"sv,
                           kSun = "\x59\xa6\x6a\x95"sv;

uint64_t number_at(std::string_view bytes, size_t at, size_t count, bool big_endian) {
  uint64_t value = 0;
  for (size_t i = 0; i < count; ++i)
    value |= uint64_t{static_cast<unsigned char>(bytes[at + i])} << 8 * (big_endian ? count - 1 - i : i);
  return value;
}

struct Jpeg {
  Header header;
  bool whole = false;
};

/// Segment by segment, as the lengths say: a thumbnail in one of them has an image's markers too, and so may what follows the
/// end.
Jpeg read_jpeg(std::string_view bytes) {
  Jpeg jpeg;
  for (size_t at = 2;;) {
    at = bytes.find('\xff', at);  // passes over a scan's data
    if (at == bytes.npos || at + 1 >= bytes.size()) return jpeg;
    const auto marker = static_cast<unsigned char>(bytes[++at]);
    if (marker == 0xff) continue;  // filling
    ++at;
    if (marker == 0xd9) {
      jpeg.whole = true;
      return jpeg;
    }
    if (marker <= 1 || (marker >= 0xd0 && marker <= 0xd8)) continue;  // data, restarts: no length
    if (at + 2 > bytes.size()) return jpeg;
    const uint64_t length = number_at(bytes, at, 2, true);
    const bool frame = marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (frame && !jpeg.header && at + 8 <= bytes.size())
      jpeg.header = {number_at(bytes, at + 5, 2, true), number_at(bytes, at + 3, 2, true), bytes[at + 7] == 1 ? 1u : 3u};
    at += std::max<uint64_t>(length, 2);
  }
}

Header png_header(std::string_view bytes) {
  if (bytes.size() < 26 || bytes.substr(12, 4) != "IHDR") return {};
  const bool deep = bytes[24] == 16, grey = bytes[25] == 0, colour = bytes[25] == 2;
  // Palettes and grey with alpha are decoded to colour, with alpha at most.
  return ImageHeader{number_at(bytes, 16, 4, true), number_at(bytes, 20, 4, true), (grey ? 1u : colour ? 3u : 4u) << deep};
}

/// Attributes "name\0type\0" length value, an empty name behind the last.
template <class Take>
void each_exr_attribute(std::string_view bytes, const Take& take) {
  for (size_t at = 8; at < bytes.size() && bytes[at] != '\0';) {
    const size_t name = bytes.find('\0', at), type = name == bytes.npos ? name : bytes.find('\0', name + 1);
    if (type == bytes.npos || type + 5 > bytes.size()) break;
    const uint64_t length = number_at(bytes, type + 1, 4, false);
    const size_t value = type + 5;
    if (length > bytes.size() - value) break;
    take(bytes.substr(at, name - at), bytes.substr(value, length));
    at = value + length;
  }
}

/// Of two data windows the reader takes the later.
Header exr_header(std::string_view bytes) {
  Header header;
  each_exr_attribute(bytes, [&](std::string_view name, std::string_view value) {
    if (name != "dataWindow" || value.size() != 16) return;
    const auto side = [&](size_t low) {
      const auto corner = [&](size_t i) { return int64_t{static_cast<int32_t>(number_at(value, i, 4, false))}; };
      return static_cast<uint64_t>(std::max<int64_t>(corner(low + 8) - corner(low) + 1, 0));
    };
    header = ImageHeader{side(0), side(4), 12};
  });
  return header;
}

/// P1 to P6 and PFM: words, comments between them. P7: a line a key.
Header pnm_header(std::string_view bytes) {
  const std::string head(bytes.substr(0, 4096));
  std::string words;
  for (const std::string_view line : lines_of(head)) words += std::string(line.substr(0, line.find('#'))) + " ";
  const std::vector<std::string> word = split_words(words);
  const auto number = [&](size_t i) { return i < word.size() ? to_number(word[i]).value_or(0) : 0; };
  const auto key = [&](const char* name) {
    return number(static_cast<size_t>(std::find(word.begin(), word.end(), name) - word.begin()) + 1);
  };
  const char kind = bytes[1];
  const bool pam = kind == '7', is_float = kind == 'F' || kind == 'f';
  const double width = pam ? key("WIDTH") : number(1), height = pam ? key("HEIGHT") : number(2);
  if (!(width >= 1 && width < 4294967296.0 && height >= 1 && height < 4294967296.0)) return {};
  const double most = pam ? key("MAXVAL") : kind == '1' || kind == '4' ? 1 : number(3);
  const uint64_t channels =
      pam ? static_cast<uint64_t>(std::clamp(key("DEPTH"), 1.0, 4.0)) : (kind == '3' || kind == '6' || kind == 'F' ? 3 : 1);
  return ImageHeader{static_cast<uint64_t>(width), static_cast<uint64_t>(height),
                     channels * (is_float     ? 4
                                 : most > 255 ? 2
                                              : 1)};
}

/// Lines of text, an empty one, then "-Y 480 +X 640".
Header radiance_header(std::string_view bytes) {
  const size_t end = std::min(bytes.find("\n\n"), bytes.find("\r\n\r\n"));
  if (end == bytes.npos) return {};
  const std::vector<std::string> word = split_words(bytes.substr(end, 100));
  if (word.size() < 4) return {};
  const double a = to_number(word[1]).value_or(0), b = to_number(word[3]).value_or(0);
  if (!(a >= 1 && a < 4294967296.0 && b >= 1 && b < 4294967296.0)) return {};
  return ImageHeader{static_cast<uint64_t>(b), static_cast<uint64_t>(a), 12};
}

}  // namespace

Header image_header(std::string_view bytes) {
  if (bytes.starts_with(kJpeg)) return read_jpeg(bytes).header;
  if (bytes.starts_with(kPng)) return png_header(bytes);
  if (bytes.starts_with(kExr)) return exr_header(bytes);
  if (bytes.starts_with("#?RADIANCE") || bytes.starts_with("#?RGBE")) return radiance_header(bytes);
  if (bytes.starts_with(kSun) && bytes.size() >= 12)
    return ImageHeader{number_at(bytes, 4, 4, true), number_at(bytes, 8, 4, true), 3};
  if (bytes.size() >= 2 && bytes[0] == 'P' && "1234567Ff"sv.find(bytes[1]) != bytes.npos) return pnm_header(bytes);
  return {};
}

std::string exr_channels(std::string_view bytes) {
  std::string names;
  if (!bytes.starts_with(kExr)) return names;
  each_exr_attribute(bytes, [&](std::string_view name, std::string_view value) {
    constexpr size_t kBehindName = 17;  // type, linearity, sampling
    if (name != "channels") return;
    for (size_t at = 0; at < value.size() && value[at] != '\0';) {
      const size_t end = value.find('\0', at);
      if (end == value.npos) break;
      names += (names.empty() ? "" : ",") + std::string(value.substr(at, end - at));
      at = end + kBehindName;
    }
  });
  return names;
}

double pfm_scale(std::string_view bytes) {
  if (bytes.size() < 2 || bytes[0] != 'P' || (bytes[1] != 'f' && bytes[1] != 'F')) return 1;
  const std::vector<std::string> word = split_words(bytes.substr(0, 200));
  return word.size() > 3 ? std::abs(to_number(word[3]).value_or(1)) : 1;
}

bool is_truncated_jpeg(std::string_view bytes) { return bytes.starts_with(kJpeg.substr(0, 2)) && !read_jpeg(bytes).whole; }

bool is_truncated_png(std::string_view bytes) { return bytes.starts_with(kPng) && bytes.find("IEND", 8) == bytes.npos; }

}  // namespace iclk
