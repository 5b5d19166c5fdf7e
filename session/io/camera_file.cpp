#include <iclk/session/io/camera_file.h>

#include <algorithm>
#include <cmath>

#include <iclk/engine/error.h>
#include <iclk/session/io/distortion.h>
#include <iclk/session/io/foreign_camera.h>
#include <iclk/session/io/yaml.h>

namespace iclk {
namespace {

[[noreturn]] void fail(const std::string& source, const std::string& why) {
  throw Error(ErrorCode::invalid_argument, source + ": " + why);
}

/// Checks the side of an image. 1e9 pixels per side are a typing error or an attack.
int side(double value, const std::string& source) {
  if (!(value >= 1 && value <= 65536) || value != std::floor(value)) {
    fail(source, "image size " + std::to_string(value) + " is not a whole number from 1 to 65536");
  }
  return static_cast<int>(value);
}

void set_intrinsics(CameraFile& file, const std::vector<double>& k) {
  file.camera.fx = k[0], file.camera.fy = k[1], file.camera.cx = k[2], file.camera.cy = k[3];
  if (k.size() >= 6) file.camera.width = side(k[4], file.source), file.camera.height = side(k[5], file.source);
}

/// The keys of a YAML file; messages name file and key.
struct Keys {
  const Yaml& yaml;
  const std::string& source;

  std::vector<double> numbers(const std::string& key, size_t count) const {
    const auto* words = yaml.find(key);
    if (words == nullptr) fail(source, "key '" + key + "' is missing");
    std::vector<double> out;
    for (const std::string& word : *words) {
      const auto value = to_number(word);
      if (!value) fail(source, "key '" + key + "': '" + printable(word) + "' is not a number");
      out.push_back(*value);
    }
    if (count != 0 && out.size() != count)
      fail(source, "key '" + key + "' has " + std::to_string(out.size()) + " numbers, not " + std::to_string(count));
    return out;
  }
  std::string text(const std::string& key) const {
    const auto* words = yaml.find(key);
    return words == nullptr || words->empty() ? "" : words->front();
  }
  /// The first spelling that the file has, or the first one if it has none.
  std::string spelling(std::initializer_list<const char*> keys) const {
    for (const char* key : keys)
      if (yaml.find(key) != nullptr) return key;
    return *keys.begin();
  }
};

/// cam0.intrinsics: [fu, fv, pu, pv]; EuRoC's sensor.yaml has the same keys without a camera's name.
void read_kalibr(const Keys& keys, const std::string& prefix, CameraFile& file) {
  const std::string model = keys.text(prefix + "camera_model");
  if (!model.empty() && model != "pinhole")
    fail(file.source, "key '" + prefix + "camera_model' is '" + printable(model) + "'; only pinhole cameras are supported");
  std::vector<double> k = keys.numbers(prefix + "intrinsics", 4);
  const std::vector<double> size = keys.numbers(prefix + "resolution", 2);
  k.insert(k.end(), size.begin(), size.end());
  set_intrinsics(file, k);
  const std::string coefficients = keys.yaml.find(prefix + "distortion_coeffs") != nullptr ? prefix + "distortion_coeffs"
                                                                                           : prefix + "distortion_coefficients";
  const std::string distortion = keys.text(prefix + "distortion_model");
  if (distortion.empty() && keys.yaml.find(coefficients) == nullptr) return;
  if (distortion.empty()) fail(file.source, "key '" + prefix + "distortion_model' is missing");
  if (distortion == "none" && keys.yaml.find(coefficients) == nullptr) return;
  file.distortion = make_distortion(distortion, keys.numbers(coefficients, 0), file.source);
}

/// A 3x3 camera matrix, row by row.
std::vector<double> matrix_intrinsics(const std::vector<double>& m, const std::string& key, const std::string& source) {
  if (m[1] != 0)
    fail(source, "key '" + key + "' has a skew of " + std::to_string(m[1]) + "; only cameras without skew are supported");
  if (m[3] != 0 || m[6] != 0 || m[7] != 0 || m[8] != 1)
    fail(source, "key '" + key + "' is not a camera matrix fx 0 cx 0 fy cy 0 0 1, row by row");
  return {m[0], m[4], m[2], m[5]};
}

/// A lens from OpenCV or ROS. Without a name, five or more coefficients are those of cv::calibrateCamera(); four may also be
/// those of cv::fisheye.
Distortion opencv_lens(const Keys& keys, const std::vector<double>& k) {
  const bool none = std::all_of(k.begin(), k.end(), [](double x) { return x == 0; });
  std::string model = keys.text("distortion_model");
  const std::string fisheye = keys.text("fisheye_model");
  if (model.empty() && !fisheye.empty()) model = fisheye == "1" ? "fisheye" : "radtan";
  if (keys.yaml.find("xi") != nullptr)
    fail(keys.source, "key 'xi' belongs to an omnidirectional camera, which is not supported");
  if (model.empty() && k.size() == 4 && !none)
    fail(keys.source,
         "four distortion coefficients without a model are ambiguous (plain lens or cv::fisheye); add a line "
         "'distortion_model: plumb_bob' or 'distortion_model: equidistant' to the file");
  if (none && model != "equidistant" && model != "fisheye") return {};
  return make_distortion(model.empty() ? "radtan" : model, k, keys.source);
}

/// Whole sensor, region of interest and binning of a ROS camera_info; other files have only the size.
void read_extent(const Keys& keys, CameraFile& file) {
  const std::string width = keys.spelling({"image_width", "image_Width", "width"}),
                    height = keys.spelling({"image_height", "image_Height", "height"}),
                    size = keys.spelling({"image_size", "imageSize", "ImageSize", "size"});
  const auto whole = [&](const std::string& key, double missing) {
    const double value = keys.yaml.find(key) != nullptr ? keys.numbers(key, 1)[0] : missing;
    if (!(value >= 0 && value <= 65536) || value != std::floor(value))
      fail(file.source, "key '" + key + "' is " + std::to_string(value) + ", not a whole number from 0 to 65536");
    return static_cast<int>(value);
  };
  Camera& c = file.camera;
  if (keys.yaml.find(width) != nullptr || keys.yaml.find(height) != nullptr) {
    c.width = side(keys.numbers(width, 1)[0], file.source), c.height = side(keys.numbers(height, 1)[0], file.source);
  } else if (keys.yaml.find(size) != nullptr) {
    const std::vector<double> sides = keys.numbers(size, 2);
    c.width = side(sides[0], file.source), c.height = side(sides[1], file.source);
  }
  const int x = whole("roi.x_offset", 0), y = whole("roi.y_offset", 0), w = whole("roi.width", 0), h = whole("roi.height", 0);
  const int bin_x = std::max(whole("binning_x", 1), 1), bin_y = std::max(whole("binning_y", 1), 1);
  const bool region = x > 0 || y > 0 || w > 0 || h > 0;
  if (c.width == 0 && (region || bin_x > 1 || bin_y > 1))
    fail(file.source, "a region of interest or binning needs width and height of the whole image");
  if (region && (w == 0 || h == 0 || x + w > c.width || y + h > c.height))
    fail(file.source, "the region of interest (roi) is empty or reaches beyond the image");
  file.region = region && (w != c.width || h != c.height);
  if (region) c = {c.fx, c.fy, c.cx - x, c.cy - y, w, h};
  if (bin_x > 1 || bin_y > 1) c = c.resized(std::max(c.width / bin_x, 1), std::max(c.height / bin_y, 1));
}

void read_opencv(const Keys& keys, CameraFile& file) {
  const std::string matrix = keys.spelling({"camera_matrix", "Camera_Matrix", "K", "k"});
  const std::vector<double> m = keys.numbers(keys.yaml.has_children(matrix) ? matrix + ".data" : matrix, 9);
  set_intrinsics(file, matrix_intrinsics(m, matrix, file.source));
  read_extent(keys, file);
  const std::string d = keys.spelling({"distortion_coefficients", "Distortion_Coefficients", "D", "d", "dist_coeffs"});
  if (keys.yaml.find(d) == nullptr) return;
  file.distortion = opencv_lens(keys, keys.numbers(keys.yaml.has_children(d) ? d + ".data" : d, 0));
}

void read_line(std::string_view text, CameraFile& file) {
  std::vector<double> k;
  for (const std::string_view line : lines_of(text)) {
    const std::vector<double> more = parse_numbers(without_comment(line), file.source);
    k.insert(k.end(), more.begin(), more.end());
    if (k.size() > 7) break;
  }
  if (k.size() != 4 && k.size() != 6 && k.size() != 7)
    fail(file.source, "'fx fy cx cy [width height [depth_scale]]' expected, found " + std::to_string(k.size()) + " numbers");
  set_intrinsics(file, k);
  if (k.size() == 7) {
    if (!(std::isfinite(k[6]) && k[6] > 0)) fail(file.source, "depth_scale " + std::to_string(k[6]) + " must be positive");
    file.depth_scale = k[6];
  }
}

void check_intrinsics(const CameraFile& file) {
  Camera checked = file.camera;
  if (checked.width == 0) checked.width = checked.height = 1;
  try {
    checked.check();
  } catch (const Error& e) {
    fail(file.source, e.what());
  }
}

CameraFile load_file(const std::string& path, const FileReader& read) {
  CameraFile file;
  file.source = "camera " + path;
  std::string text;
  try {
    text = read(path, size_t{1} << 20);
  } catch (const Error& e) {
    throw Error(e.code(), std::string(e.what()) + "; give fx,fy,cx,cy[,width,height] or a camera file");
  }
  if (trim(text).empty()) fail(file.source, "the file is empty");
  std::string_view first;
  for (const std::string_view line : lines_of(text))
    if (first = without_comment(line); !first.empty()) break;
  if (read_colmap(text, file)) return file;
  if (const std::string foreign = foreign_format(text); !foreign.empty())
    fail(file.source, "this is " + foreign +
                          ", which is not supported; give fx,fy,cx,cy[,width,height], or a file of Kalibr, "
                          "EuRoC, OpenCV (YAML), ROS or COLMAP");
  if (first.find(':') == std::string_view::npos && !first.starts_with("---")) {
    read_line(text, file);
    return file;
  }
  const Yaml yaml(text, path);
  const Keys keys{yaml, file.source};
  if (yaml.has_children("cam0"))
    read_kalibr(keys, "cam0.", file);
  else if (yaml.find("intrinsics") != nullptr)
    read_kalibr(keys, "", file);
  else if (yaml.find("camera_matrix") != nullptr || yaml.find("Camera_Matrix") != nullptr || yaml.find("K") != nullptr ||
           yaml.find("k") != nullptr)
    read_opencv(keys, file);
  else
    fail(file.source, "key 'intrinsics' (EuRoC), 'cam0' (Kalibr) or 'camera_matrix' (OpenCV) is missing");
  return file;
}

}  // namespace

CameraFile load_camera(const std::string& text_or_path, const FileReader& read) {
  // A list of numbers is never treated as a path, so that typing errors in it are reported as such.
  const std::string text(trim(text_or_path));
  CameraFile file;
  if (text.empty()) fail("--camera", "fx,fy,cx,cy[,width,height] or a camera file is needed");
  if (text.find_first_not_of("0123456789.,+-eE ") == std::string::npos && text.find(',') != std::string::npos) {
    file.source = "--camera " + printable(text);
    const std::vector<double> k = parse_numbers(text, file.source);
    if (k.size() != 4 && k.size() != 6)
      fail(file.source, "fx,fy,cx,cy[,width,height] expected, found " + std::to_string(k.size()) + " numbers");
    set_intrinsics(file, k);
  } else {
    file = load_file(text, read);
  }
  check_intrinsics(file);
  return file;
}

CameraFile kalibr_camera(const Yaml& yaml, const std::string& prefix, const std::string& source) {
  CameraFile file;
  file.source = source;
  read_kalibr(Keys{yaml, source}, prefix, file);
  check_intrinsics(file);
  return file;
}

CameraFile opencv_camera(const Yaml& yaml, const std::string& matrix, const std::string& coefficients,
                         const std::string& source) {
  CameraFile file;
  file.source = source;
  const Keys keys{yaml, file.source};
  set_intrinsics(file, matrix_intrinsics(yaml_numbers(yaml, matrix, 9, source), matrix, source));
  read_extent(keys, file);
  if (yaml.find(coefficients) != nullptr) file.distortion = opencv_lens(keys, yaml_numbers(yaml, coefficients, 0, source));
  check_intrinsics(file);
  return file;
}

std::vector<double> yaml_numbers(const Yaml& yaml, const std::string& key, size_t count, const std::string& source) {
  const std::string with_data = key + ".data";
  std::vector<double> numbers = Keys{yaml, source}.numbers(yaml.find(with_data) != nullptr ? with_data : key, count);
  for (const double x : numbers)
    if (!std::isfinite(x)) fail(source, "key '" + key + "' has a number that is not finite");
  return numbers;
}

Camera fit_camera(const CameraFile& file, int width, int height) {
  Camera camera = file.camera;
  if (camera.width == 0) {
    camera.width = width, camera.height = height;
  } else if (camera.width != width || camera.height != height) {
    if (file.region)
      fail(file.source, "the region of interest has " + std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                            " pixels, but the image has " + std::to_string(width) + "x" + std::to_string(height) +
                            "; give the camera_info of this image, or fx,fy,cx,cy");
    // The sides of a resized image are rounded by up to a pixel.
    const double scale = static_cast<double>(width) / camera.width;
    if (std::abs(camera.height * scale - height) > 1 + scale)
      fail(file.source, "the intrinsics belong to " + std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                            ", but the image is " + std::to_string(width) + "x" + std::to_string(height) +
                            ", another aspect ratio: it was cropped; give the intrinsics of the cropped image");
    camera = camera.resized(width, height);
  }
  try {
    camera.check();
  } catch (const Error& e) {
    fail(file.source, e.what());
  }
  return camera;
}

}  // namespace iclk
