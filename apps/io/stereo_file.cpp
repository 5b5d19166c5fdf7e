#include "apps/io/stereo_file.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>
#include <iclk/session/io/yaml.h>

namespace iclk {
namespace {

namespace fs = std::filesystem;
constexpr size_t kMaxBytes = size_t{1} << 20;

[[noreturn]] void fail(const std::string& source, const std::string& why) {
  throw Error(ErrorCode::invalid_argument, source + ": " + why);
}

SE3 pose_of(const Yaml& yaml, const std::string& key, const std::string& source) {
  const std::vector<double> m = yaml_numbers(yaml, key, 16, source);
  try {
    return SE3::from_matrix(Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(m.data()));
  } catch (const Error& e) {
    fail(source, "key '" + key + "': " + e.what());
  }
}

std::string numbers_text(const double* values, int rows, int columns, size_t indent) {
  std::string out = "[";
  for (int r = 0; r < rows; ++r) {
    if (r > 0) out += ",\n" + std::string(indent, ' ');
    for (int c = 0; c < columns; ++c) {
      char number[40];
      std::snprintf(number, sizeof number, "%s%.17g", c ? ", " : "", values[r * columns + c]);
      out += number;
    }
  }
  return out + "]";
}

std::string matrix_text(const SE3& T, size_t indent) {
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> M = T.matrix();
  return numbers_text(M.data(), 4, 4, indent);
}

/// The value of a dotted key, exchanged. The text has passed Yaml, and has the key.
std::string replace_value(const std::string& text, const std::string& key, const std::string& value) {
  struct Open {
    size_t indent;
    std::string prefix;
  };
  std::vector<Open> open;
  std::string out;
  bool skipping = false;
  int depth = 0;
  size_t key_indent = 0;
  for (const std::string_view line : lines_of(text)) {
    const std::string_view content = trim(line);
    const size_t indent = std::min(line.find_first_not_of(" \t"), line.size());
    const auto brackets = [&](std::string_view part) {
      for (const char c : without_comment(part)) depth += (c == '[') - (c == ']');
    };
    if (skipping) {
      const bool value_goes_on =
          depth > 0 || content.empty() || content.front() == '#' || content.starts_with("- ") || indent > key_indent;
      if (value_goes_on) {
        brackets(content);
        continue;
      }
      skipping = false;
    }
    const size_t colon = content.find(':');
    const bool has_key = depth == 0 && colon != std::string_view::npos && colon > 0 && content.front() != '#' &&
                         content.front() != '%' && !content.starts_with("- ");
    if (!has_key) {
      brackets(content);
      out += std::string(line) + "\n";
      continue;
    }
    while (!open.empty() && open.back().indent >= indent) open.pop_back();
    const std::string name = (open.empty() ? "" : open.back().prefix) + std::string(trim(content.substr(0, colon)));
    std::string_view rest = without_comment(content.substr(colon + 1));
    if (rest.starts_with("!")) rest = trim(rest.substr(std::min(rest.find(' '), rest.size())));
    if (rest.empty()) open.push_back({indent, name + "."});
    brackets(content.substr(colon + 1));
    if (name != key) {
      out += std::string(line) + "\n";
      continue;
    }
    out += std::string(line.substr(0, indent)) + std::string(trim(content.substr(0, colon))) + ": " + value + "\n";
    skipping = true;
    key_indent = indent;
  }
  return out;
}

std::string spelling(const Yaml& yaml, std::initializer_list<const char*> keys) {
  for (const char* key : keys)
    if (yaml.find(key) != nullptr) return key;
  return *keys.begin();
}

std::string data_key(const Yaml& yaml, const std::string& key) {
  return yaml.find(key + ".data") != nullptr ? key + ".data" : key;
}

StereoFile load_euroc(const std::string& folder) {
  StereoFile file;
  file.format = StereoFile::Format::euroc;
  SE3 T_BS[2];
  for (int i = 0; i < 2; ++i) {
    const std::string name = "cam" + std::to_string(i) + "/sensor.yaml", path = (fs::path(folder) / name).string();
    file.files.emplace_back(name, read_file(path, kMaxBytes));
    const Yaml yaml(file.files.back().second, path);
    (i ? file.right : file.left) = kalibr_camera(yaml, "", "camera " + path);
    T_BS[i] = pose_of(yaml, "T_BS", "camera " + path);
  }
  file.T_rl = T_BS[1].inverse() * T_BS[0];
  file.T_bl = T_BS[0];
  return file;
}

}  // namespace

StereoFile load_stereo(const std::string& path) {
  std::error_code ignored;
  StereoFile file;
  if (fs::is_directory(path, ignored)) {
    file = load_euroc(path);
  } else {
    const std::string source = "calibration " + path;
    file.files.emplace_back(fs::path(path).filename().string(), read_file(path, kMaxBytes));
    const std::string& text = file.files.front().second;
    const Yaml yaml(text, path);
    if (yaml.has_children("cam0")) {
      if (!yaml.has_children("cam1")) fail(source, "key 'cam1' is missing: this is not a rig of two cameras");
      file.format = StereoFile::Format::kalibr;
      file.left = kalibr_camera(yaml, "cam0.", source + ", cam0");
      file.right = kalibr_camera(yaml, "cam1.", source + ", cam1");
      file.T_rl = pose_of(yaml, "cam1.T_cn_cnm1", source);
    } else if (const std::string m1 = spelling(yaml, {"M1", "K1", "cameraMatrix1", "camera_matrix_1"}); yaml.find(m1)) {
      file.format = StereoFile::Format::opencv;
      file.left = opencv_camera(yaml, m1, spelling(yaml, {"D1", "distCoeffs1", "dist_coeffs_1"}), source);
      file.right = opencv_camera(yaml, spelling(yaml, {"M2", "K2", "cameraMatrix2", "camera_matrix_2"}),
                                 spelling(yaml, {"D2", "distCoeffs2", "dist_coeffs_2"}), source);
      const std::vector<double> R = yaml_numbers(yaml, "R", 9, source), t = yaml_numbers(yaml, "T", 3, source);
      Eigen::Matrix4d M = Eigen::Matrix4d::Identity();
      M.topLeftCorner<3, 3>() = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data());
      M.topRightCorner<3, 1>() = Eigen::Map<const Eigen::Vector3d>(t.data());
      try {
        file.T_rl = SE3::from_matrix(M);
      } catch (const Error& e) {
        fail(source, std::string("keys 'R' and 'T': ") + e.what());
      }
    } else {
      fail(source,
           "neither a Kalibr camchain (cam0, cam1) nor an OpenCV stereo calibration (M1, D1, M2, D2, R, T); "
           "EuRoC is given as the folder of cam0/sensor.yaml and cam1/sensor.yaml");
    }
  }
  if (!(file.T_rl.t.norm() > 0)) fail("calibration " + path, "both cameras are at one place: there is no baseline");
  return file;
}

std::vector<std::pair<std::string, std::string>> with_extrinsics(const StereoFile& file, const SE3& T_rl) {
  auto out = file.files;
  std::string& text = out.back().second;
  const Yaml yaml(text, out.back().first);
  switch (file.format) {
    case StereoFile::Format::kalibr: {
      text = replace_value(text, "cam1.T_cn_cnm1", matrix_text(T_rl, 4));
      if (yaml.find("cam0.T_cam_imu") != nullptr && yaml.find("cam1.T_cam_imu") != nullptr)
        text = replace_value(text, "cam1.T_cam_imu", matrix_text(T_rl * pose_of(yaml, "cam0.T_cam_imu", out[0].first), 4));
      break;
    }
    case StereoFile::Format::euroc: {
      const Yaml left(out[0].second, out[0].first);
      const SE3 T_BS = pose_of(left, "T_BS", out[0].first) * T_rl.inverse();
      text = replace_value(text, data_key(yaml, "T_BS"), matrix_text(T_BS, 8));
      break;
    }
    case StereoFile::Format::opencv: {
      const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> R = T_rl.R;
      text = replace_value(text, data_key(yaml, "R"), numbers_text(R.data(), 3, 3, 8));
      text = replace_value(text, data_key(yaml, "T"), numbers_text(T_rl.t.data(), 1, 3, 8));
      break;
    }
  }
  return out;
}

}  // namespace iclk
