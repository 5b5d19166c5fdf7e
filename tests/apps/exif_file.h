#pragma once
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "files.h"

namespace iclk::test {

/// A JPEG with EXIF and XMP, as cameras write it.
struct ExifFile {
  using Ratio = std::pair<uint32_t, uint32_t>;
  std::string make = "DJI";
  std::vector<Ratio> latitude, longitude, altitude;  ///< empty: none; degrees, minutes, seconds
  std::string north = "N", east = "E", status;
  uint8_t altitude_reference = 0;
  std::string xmp;  ///< attributes of rdf:Description

  void degrees(double lat, double lon) { latitude = parts(lat), longitude = parts(lon); }
  void write(const std::string& path, const cv::Mat& image) const {
    std::vector<uchar> jpeg;
    cv::imencode(".jpg", image, jpeg, {cv::IMWRITE_JPEG_QUALITY, 97});
    std::string bytes(jpeg.begin(), jpeg.end());
    std::string packet = "http://ns.adobe.com/xap/1.0/";
    packet += '\0';
    packet +=
        "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\"><rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">"
        "<rdf:Description rdf:about=\"\" " +
        xmp + "/></rdf:RDF></x:xmpmeta>";
    std::ofstream(path, std::ios::binary) << bytes.substr(0, 2) + segment(std::string("Exif\0\0", 6) + tiff()) +
                                                 segment(packet) + bytes.substr(2);
  }

 private:
  using Entries = std::map<uint16_t, std::pair<uint16_t, std::string>>;  // tag: type, bytes

  static std::vector<Ratio> parts(double d) {
    const auto units = static_cast<uint64_t>(std::llround(d * 3600e4));
    const auto part = [&](uint64_t value, uint32_t over) { return Ratio(static_cast<uint32_t>(value), over); };
    return {part(units / 36000000, 1), part(units / 600000 % 60, 1), part(units % 600000, 10000)};
  }
  static std::string little(uint64_t value, int bytes) {
    std::string all;
    for (int i = 0; i < bytes; ++i) all += static_cast<char>(value >> 8 * i & 255);
    return all;
  }
  static std::string segment(const std::string& bytes) {
    const std::string size = little(bytes.size() + 2, 2);
    return std::string("\xff\xe1") + size[1] + size[0] + bytes;
  }
  static std::string text(std::string t) { return t += '\0'; }
  static std::string ratios(const std::vector<Ratio>& all) {
    std::string bytes;
    for (const auto& [a, b] : all) bytes += little(a, 4) + little(b, 4);
    return bytes;
  }
  static std::string directory(const Entries& entries, size_t at) {
    static constexpr int kSizes[] = {0, 1, 1, 2, 4, 8};
    std::string head = little(entries.size(), 2), data;
    const size_t base = at + 2 + 12 * entries.size() + 4;
    for (const auto& [tag, value] : entries) {
      const auto& [type, bytes] = value;
      head += little(tag, 2) + little(type, 2) + little(bytes.size() / kSizes[type], 4);
      if (bytes.size() <= 4)
        head += bytes + std::string(4 - bytes.size(), '\0');
      else
        head += little(base + data.size(), 4), data += bytes;
    }
    return head + little(0, 4) + data;
  }
  std::string tiff() const {
    Entries gps;
    if (!latitude.empty()) gps[2] = {5, ratios(latitude)}, gps[4] = {5, ratios(longitude)};
    if (!north.empty()) gps[1] = {2, text(north)}, gps[3] = {2, text(east)};
    if (!altitude.empty()) gps[5] = {1, little(altitude_reference, 1)}, gps[6] = {5, ratios(altitude)};
    if (!status.empty()) gps[9] = {2, text(status)};
    Entries first = {{0x10f, {2, text(make)}}, {0x8825, {4, little(0, 4)}}};
    first[0x8825].second = little(8 + directory(first, 8).size(), 4);
    const std::string head = directory(first, 8);
    return std::string("II*\0", 4) + little(8, 4) + head + directory(gps, 8 + head.size());
  }
};

}  // namespace iclk::test
