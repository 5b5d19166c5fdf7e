#include <iclk/session/io/foreign_camera.h>

#include <algorithm>
#include <iterator>

#include <iclk/engine/error.h>
#include <iclk/session/io/distortion.h>

namespace iclk {
namespace {

struct ColmapModel {
  const char* name;
  size_t focal_lengths, coefficients;
  const char* lens;
};
constexpr ColmapModel kColmapModels[] = {
    {"SIMPLE_PINHOLE", 1, 0, "none"}, {"PINHOLE", 2, 0, "none"},  {"SIMPLE_RADIAL", 1, 1, "radtan"},
    {"RADIAL", 1, 2, "radtan"},       {"OPENCV", 2, 4, "radtan"}, {"OPENCV_FISHEYE", 2, 4, "equidistant"},
    {"FULL_OPENCV", 2, 8, "radtan"},
};
constexpr double kColmapCentre = 0.5;  // COLMAP's coordinate of the first pixel centre, which is 0 in iclk

/// `words`: CAMERA_ID MODEL WIDTH HEIGHT PARAMS...
void read_colmap_line(const std::vector<std::string>& words, CameraFile& file) {
  const auto fail = [&](const std::string& why) -> void { throw Error(ErrorCode::invalid_argument, file.source + ": " + why); };
  const auto* const model =
      std::find_if(std::begin(kColmapModels), std::end(kColmapModels), [&](const auto& m) { return words[1] == m.name; });
  if (model == std::end(kColmapModels))
    fail("COLMAP's model " + printable(words[1]) +
         " is not known; it must be SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE or FULL_OPENCV");
  std::vector<double> p;
  for (size_t i = 2; i < words.size(); ++i) {
    const auto value = to_number(words[i]);
    if (!value) fail("'" + printable(words[i]) + "' is not a number");
    p.push_back(*value);
  }
  const size_t f = model->focal_lengths;
  if (p.size() != 4 + f + model->coefficients)
    fail("COLMAP's " + words[1] + " has " + std::to_string(2 + f + model->coefficients) + " parameters, not " +
         std::to_string(std::max<size_t>(p.size(), 2) - 2));
  for (size_t i = 0; i < 2; ++i)
    if (!(p[i] >= 1 && p[i] <= 65536)) fail("image size " + words[2 + i] + " is not a whole number from 1 to 65536");
  file.camera = {
      p[2], p[1 + f], p[2 + f] - kColmapCentre, p[3 + f] - kColmapCentre, static_cast<int>(p[0]), static_cast<int>(p[1])};
  std::vector<double> k(p.begin() + static_cast<std::ptrdiff_t>(4 + f), p.end());
  if (!k.empty()) k.resize(std::max<size_t>(k.size(), 4));
  file.distortion = make_distortion(model->lens, k, file.source);
}

}  // namespace

bool read_colmap(std::string_view text, CameraFile& file) {
  std::vector<std::string> first;
  for (const std::string_view line : lines_of(text)) {
    const std::vector<std::string> words = split_words(without_comment(line));
    if (words.empty()) continue;
    const bool named = words.size() > 4 &&
                       words[1].find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789") == words[1].npos &&
                       words[1].front() >= 'A';
    if (first.empty() && (!named || !to_number(words[0]))) return false;
    if (!first.empty() && !std::equal(words.begin() + 1, words.end(), first.begin() + 1, first.end()))
      throw Error(ErrorCode::invalid_argument, file.source + ": has several cameras; give a file with the line of one");
    if (first.empty()) read_colmap_line(words, file);
    first = words;
  }
  return !first.empty();
}

std::string foreign_format(std::string_view text) {
  constexpr std::pair<const char*, const char*> marks[] = {
      {"<opencv_storage", "OpenCV's XML"},
      {"<?xml", "XML"},
      {"Camera.fx", "a settings file of ORB-SLAM"},
      {"Camera1.fx", "a settings file of ORB-SLAM3"},
      {"projection_parameters", "a camera of VINS or camodocal"},
      {"camera_angle_x", "a transforms.json of NeRF"},
      {"fl_x", "a transforms.json of nerfstudio"},
      {"intrinsic_matrix", "a camera of Open3D"},
      {"value0", "a calibration of Basalt"},
      {"P_rect_0", "a calibration of KITTI"},
      {"P0:", "a calibration of KITTI"},
      {"cam0=[", "a calib.txt of Middlebury"},
      {"RadTan ", "a camera of DSO"},
      {"Pinhole ", "a camera of DSO"},
      {"FOV ", "a camera of DSO"},
      {"EquiDistant ", "a camera of DSO"},
  };
  if (text.starts_with("\xff\xfe") || text.starts_with("\xfe\xff")) return "a text in UTF-16";
  for (const std::string_view line : lines_of(text)) {
    std::string_view begin = without_comment(line);
    begin.remove_prefix(std::min(begin.find_first_not_of(" {\"'"), begin.size()));
    for (const auto& [mark, name] : marks)
      if (begin.starts_with(mark)) return name;
  }
  return trim(text).starts_with('{') ? "JSON" : "";
}

}  // namespace iclk
