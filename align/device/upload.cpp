#include <iclk/align/device/upload.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include <iclk/align/pyramid.h>

#if defined(__x86_64__) && defined(__GNUC__)
#include <cpuid.h>
#include <tmmintrin.h>
#endif

namespace iclk::internal {
namespace {

bool is_bgr(PixelFormat f) { return f == PixelFormat::bgr8 || f == PixelFormat::bgra8 || f == PixelFormat::bgr16; }

uint8_t to_byte(float x) { return static_cast<uint8_t>(std::lround(255.0f * std::clamp(x, 0.0f, 1.0f))); }

// Converts one row of any format to floats in [0, 1] (floats are unchanged), RGB or single channel.
template <class T>
void read_row(const ImageView& image, int v, float scale, std::vector<float>& out) {
  const size_t n = static_cast<size_t>(image.width) * channels(image.format);
  std::vector<T> row(n);
  std::memcpy(row.data(), image.row(v), n * sizeof(T));
  out.resize(n);
  for (size_t i = 0; i < n; ++i) out[i] = static_cast<float>(row[i]) * scale;
}

void row_as_float(const ImageView& image, int v, std::vector<float>& out) {
  const size_t size = bytes_per_pixel(image.format) / static_cast<size_t>(channels(image.format));
  if (size == 1)
    read_row<uint8_t>(image, v, 1.0f / 255.0f, out);
  else if (size == 2)
    read_row<uint16_t>(image, v, 1.0f / 65535.0f, out);
  else
    read_row<float>(image, v, 1.0f, out);
}

// Converts three bytes per pixel, four pixels at a time, if the processor can shuffle bytes. Returns the number of converted
// pixels.
#if defined(__x86_64__) && defined(__GNUC__)
template <bool kSwap>
[[gnu::target("ssse3")]] int four_at_a_time(const uint8_t* p, int width, uint8_t* out) {
  const __m128i places = kSwap ? _mm_setr_epi8(2, 1, 0, -1, 5, 4, 3, -1, 8, 7, 6, -1, 11, 10, 9, -1)
                               : _mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
  const __m128i alpha = _mm_set1_epi32(static_cast<int>(0xff000000u));
  int u = 0;
  for (; u + 6 <= width; u += 4) {  // sixteen bytes are read, of which four belong to the next pixels
    const __m128i in = _mm_loadu_si128(reinterpret_cast<const __m128i*>(p + 3 * static_cast<size_t>(u)));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(out + 4 * static_cast<size_t>(u)),
                     _mm_or_si128(_mm_shuffle_epi8(in, places), alpha));
  }
  return u;
}
template <bool kSwap>
int whole_fours(const uint8_t* p, int width, uint8_t* out) {
  static const bool can = [] {
    unsigned a = 0, b = 0, c = 0, d = 0;
    return __get_cpuid(1, &a, &b, &c, &d) != 0 && (c & bit_SSSE3) != 0;
  }();
  return can ? four_at_a_time<kSwap>(p, width, out) : 0;
}
#else
template <bool kSwap>
int whole_fours(const uint8_t*, int, uint8_t*) {
  return 0;
}
#endif

// Converts 8-bit pixels of N bytes to four bytes, the common case, without floats.
template <int N, bool kSwap>
void bytes_to_four(const ImageView& image, int v, uint8_t* out) {
  const uint8_t* p = image.row(v);
  int u = 0;
  if constexpr (N == 3) u = whole_fours<kSwap>(p, image.width, out);
  for (; u < image.width; ++u) {
    const uint8_t* pixel = p + static_cast<size_t>(u) * N;
    const std::array<uint8_t, 4> four{pixel[kSwap ? 2 : 0], pixel[N == 1 ? 0 : 1], pixel[N == 1 || kSwap ? 0 : 2], 255};
    std::memcpy(out + 4 * static_cast<size_t>(u), four.data(), 4);  // in one write: single bytes are slow in uncached memory
  }
}

using ToFour = void (*)(const ImageView&, int, uint8_t*);
ToFour to_four(int channels, bool swap) {
  if (channels == 1) return bytes_to_four<1, false>;
  if (channels == 3) return swap ? bytes_to_four<3, true> : bytes_to_four<3, false>;
  return swap ? bytes_to_four<4, true> : bytes_to_four<4, false>;
}

}  // namespace

void convert_pixels(const ImageView& image, PixelFormat format, uint32_t row_pixels, void* out) {
  const size_t pitch = row_pixels * bytes_per_pixel(format);
  auto* bytes = static_cast<uint8_t*>(out);
  const bool eight_bit = bytes_per_pixel(image.format) == static_cast<size_t>(channels(image.format));
  if (image.format == format) {
    for (int v = 0; v < image.height; ++v, bytes += pitch)
      std::memcpy(bytes, image.row(v), static_cast<size_t>(image.width) * bytes_per_pixel(format));
    return;
  }
  if (eight_bit && (format == PixelFormat::rgba8 || format == PixelFormat::bgra8)) {
    const ToFour row = to_four(channels(image.format), is_bgr(image.format) != is_bgr(format));
    for (int v = 0; v < image.height; ++v, bytes += pitch) row(image, v, bytes);
    return;
  }
  if (channels(format) == 1) {
    const Map grey = grey_map(image);
    for (int v = 0; v < image.height; ++v, bytes += pitch) {
      const float* row = &grey.data[static_cast<size_t>(v) * image.width];
      if (format == PixelFormat::r32f)
        std::memcpy(bytes, row, sizeof(float) * image.width);
      else
        std::transform(row, row + image.width, bytes, to_byte);
    }
    return;
  }
  std::vector<float> row;
  const int n = channels(image.format), r = is_bgr(image.format) ? 2 : 0;
  for (int v = 0; v < image.height; ++v, bytes += pitch) {
    row_as_float(image, v, row);
    for (int u = 0; u < image.width; ++u) {
      const float* p = row.data() + static_cast<size_t>(u) * n;
      const std::array<float, 4> rgba = n == 1 ? std::array{p[0], p[0], p[0], 1.0f} : std::array{p[r], p[1], p[2 - r], 1.0f};
      if (format == PixelFormat::rgba32f) {
        std::memcpy(bytes + sizeof(rgba) * u, rgba.data(), sizeof(rgba));
      } else {
        uint8_t* q = bytes + 4 * static_cast<size_t>(u);
        const bool swap = format == PixelFormat::bgra8;
        for (int c = 0; c < 4; ++c) q[swap && c != 3 ? 2 - c : c] = to_byte(rgba[static_cast<size_t>(c)]);
      }
    }
  }
}

}  // namespace iclk::internal
