// Aligns two images whose depth is known in the first, with the library alone:
//   example_align a.ppm b.ppm a_depth.pgm 5000 517.3 516.5 318.6 255.3 [device]
// 5000 is how many units of the depth image a metre has; then fx, fy, cx, cy. Prints the status and T_10.
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include <iclk/iclk.h>

struct Image {
  int width = 0, height = 0, channels = 1;
  std::vector<uint8_t> bytes;
};

/// A binary PGM or PPM file of 8 bits, or with `deep` a PGM file of 16.
Image read(const std::string& path, bool deep) {
  std::ifstream file(path, std::ios::binary);
  std::string kind;
  int width = 0, height = 0, most = 0;
  (file >> kind >> width >> height >> most).get();
  const bool sized = width > 0 && height > 0 && width <= 16384 && height <= 16384;
  if (!file || !sized || (kind != "P5" && (deep || kind != "P6")) || (most > 255) != deep)
    throw iclk::Error(iclk::ErrorCode::io, path + (deep ? " is no PGM of 16 bits" : " is no binary PGM or PPM"));
  Image image{width, height, kind == "P6" ? 3 : 1, {}};
  image.bytes.resize(static_cast<size_t>(width * height * (deep ? 2 : image.channels)));
  file.read(reinterpret_cast<char*>(image.bytes.data()), static_cast<std::streamsize>(image.bytes.size()));
  if (!file) throw iclk::Error(iclk::ErrorCode::io, path + " ends before its last pixel");
  return image;
}

iclk::ImageView view(const Image& image) {
  const auto format = image.channels == 1 ? iclk::PixelFormat::r8 : iclk::PixelFormat::rgb8;
  return {image.bytes.data(), image.width, image.height, 0, format};
}

/// Of 16-bit depth, whose bytes come high first.
std::vector<float> metres(const Image& depth, float scale) {
  std::vector<float> z(depth.bytes.size() / 2);
  for (size_t i = 0; i < z.size(); ++i)
    z[i] = static_cast<float>(depth.bytes[2 * i] << 8 | depth.bytes[2 * i + 1]) * (1 / scale);
  return z;
}

int main(int count, char** words) try {
  if (count < 9) return std::fputs("a.ppm b.ppm a_depth.pgm SCALE FX FY CX CY [DEVICE]\n", stderr), 2;
  const Image reference = read(words[1], false), target = read(words[2], false), raw = read(words[3], true);
  const std::vector<float> depth = metres(raw, std::stof(words[4]));
  const iclk::Camera camera{std::stod(words[5]), std::stod(words[6]), std::stod(words[7]),
                            std::stod(words[8]), reference.width,     reference.height};
  const iclk::ImageView depth_view{depth.data(), raw.width, raw.height, 0, iclk::PixelFormat::r32f};
  const iclk::Answer answer =
      iclk::align(view(reference), depth_view, view(target), camera, {.device = count > 9 ? words[9] : ""});
  std::printf("%s: %s\n", iclk::name(answer.status), answer.reason.c_str());
  const Eigen::Matrix4d T = answer.T_10.matrix();
  for (int r = 0; r < 4; ++r) std::printf("%.17g %.17g %.17g %.17g\n", T(r, 0), T(r, 1), T(r, 2), T(r, 3));
  return answer.converged() ? 0 : 1;
} catch (const std::exception& e) {
  return std::fprintf(stderr, "%s\n", e.what()), 2;
}
