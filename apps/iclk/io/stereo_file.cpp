#include "apps/iclk/io/stereo_file.h"

#include <algorithm>
#include <filesystem>
#include <initializer_list>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>
#include <iclk/session/io/yaml.h>

#include "apps/json/format.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;
constexpr size_t kMaxBytes = size_t{1} << 20;
constexpr std::initializer_list<const char*> kMatrices1 = {"M1", "K1", "cameraMatrix1", "camera_matrix_1"};

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

std::string numbers_text(const double* values, int rows, int columns, size_t indent, bool nested = false) {
  std::string out = nested ? "[[" : "[";
  for (int r = 0; r < rows; ++r) {
    if (r > 0) out += (nested ? "],\n" : ",\n") + std::string(indent, ' ') + (nested ? "[" : "");
    for (int c = 0; c < columns; ++c) out += formatted("%s%.17g", c ? ", " : "", values[r * columns + c]);
  }
  return out + (nested ? "]]" : "]");
}

/// Kalibr and those who read its files want a list of four rows; OpenCV and EuRoC have one list under `data`.
std::string matrix_text(const SE3& T, size_t indent, bool nested) {
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> M = T.matrix();
  return numbers_text(M.data(), 4, 4, indent, nested);
}

std::string spelling(const Yaml& yaml, std::initializer_list<const char*> keys) {
  for (const char* key : keys)
    if (yaml.find(key) != nullptr || yaml.has_children(key)) return key;
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

/// Of the files of cv::stereoCalibrate(): M1, D1, M2, D2 in the first, R and T in the last, which may be the same.
void read_opencv_rig(const std::string& source, const Yaml& cameras, const Yaml& pose, StereoFile& file) {
  file.format = StereoFile::Format::opencv;
  file.left =
      opencv_camera(cameras, spelling(cameras, kMatrices1), spelling(cameras, {"D1", "distCoeffs1", "dist_coeffs_1"}), source);
  file.right = opencv_camera(cameras, spelling(cameras, {"M2", "K2", "cameraMatrix2", "camera_matrix_2"}),
                             spelling(cameras, {"D2", "distCoeffs2", "dist_coeffs_2"}), source);
  const std::vector<double> R = yaml_numbers(pose, "R", 9, source), t = yaml_numbers(pose, "T", 3, source);
  Eigen::Matrix4d M = Eigen::Matrix4d::Identity();
  M.topLeftCorner<3, 3>() = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data());
  M.topRightCorner<3, 1>() = Eigen::Map<const Eigen::Vector3d>(t.data());
  try {
    file.T_rl = SE3::from_matrix(M);
  } catch (const Error& e) {
    fail(source, std::string("keys 'R' and 'T': ") + e.what());
  }
}

bool has_pose(const Yaml& yaml) {
  return yaml.find(data_key(yaml, "R")) != nullptr && yaml.find(data_key(yaml, "T")) != nullptr;
}

/// extrinsics.yml of intrinsics.yml, or the other way round: OpenCV's sample stereo_calib writes both.
std::string beside(const std::string& path, const std::string& name) {
  for (const char* ending : {".yml", ".yaml"}) {
    std::error_code ignored;
    const fs::path other = fs::path(path).parent_path() / (name + ending);
    if (fs::exists(other, ignored)) return other.string();
  }
  fail("calibration " + path,
       "the " + name + " of this OpenCV calibration are missing: put " + name + ".yml into the same folder");
}

void add_file(StereoFile& file, const std::string& path) {
  file.files.emplace_back(fs::path(path).filename().string(), read_file(path, kMaxBytes));
}

StereoFile load_one_file(const std::string& path) {
  StereoFile file;
  const std::string source = "calibration " + path;
  add_file(file, path);
  const Yaml yaml(file.files.front().second, path);
  const bool cameras = yaml.has_children("cam0"), matrices = yaml.find(data_key(yaml, spelling(yaml, kMatrices1))) != nullptr;
  if (cameras) {
    if (!yaml.has_children("cam1")) fail(source, "key 'cam1' is missing: this is not a rig of two cameras");
    file.format = StereoFile::Format::kalibr;
    file.left = kalibr_camera(yaml, "cam0.", source + ", cam0");
    file.right = kalibr_camera(yaml, "cam1.", source + ", cam1");
    file.T_rl = pose_of(yaml, "cam1.T_cn_cnm1", source);
  } else if (matrices && has_pose(yaml)) {
    read_opencv_rig(source, yaml, yaml, file);
  } else if (matrices) {
    const std::string other = beside(path, "extrinsics");
    add_file(file, other);
    read_opencv_rig(source, yaml, Yaml(file.files.back().second, other), file);
  } else if (has_pose(yaml)) {
    return load_one_file(beside(path, "intrinsics"));
  } else {
    fail(source,
         "neither a Kalibr camchain (cam0, cam1) nor an OpenCV stereo calibration (M1, D1, M2, D2, R, T); "
         "for EuRoC give the folder with cam0/sensor.yaml and cam1/sensor.yaml");
  }
  return file;
}

}  // namespace

StereoFile load_stereo(const std::string& path) {
  std::error_code ignored;
  const fs::path intrinsics = fs::path(path) / "intrinsics.yml";
  StereoFile file = !fs::is_directory(path, ignored)  ? load_one_file(path)
                    : fs::exists(intrinsics, ignored) ? load_one_file(intrinsics.string())
                                                      : load_euroc(path);
  if (!(file.T_rl.t.norm() > 0)) fail("calibration " + path, "both cameras have the same position: the baseline is 0");
  return file;
}

std::vector<std::pair<std::string, std::string>> with_extrinsics(const StereoFile& file, const SE3& T_rl) {
  auto out = file.files;
  const auto& [name, before] = file.files.back();
  std::string& text = out.back().second;
  const auto replace = [&](const std::string& key, const std::string& value) {
    text = with_value(text, Yaml(text, name), key, value);
  };
  const Yaml yaml(before, name);
  switch (file.format) {
    case StereoFile::Format::kalibr: {
      replace("cam1.T_cn_cnm1", matrix_text(T_rl, 4, true));
      if (yaml.find("cam0.T_cam_imu") != nullptr && yaml.find("cam1.T_cam_imu") != nullptr)
        replace("cam1.T_cam_imu", matrix_text(T_rl * pose_of(yaml, "cam0.T_cam_imu", name), 4, true));
      break;
    }
    case StereoFile::Format::euroc: {
      const std::string key = data_key(yaml, "T_BS");
      const SE3 T_BS = file.T_bl * T_rl.inverse();
      replace(key, matrix_text(T_BS, 8, key == "T_BS"));
      break;
    }
    case StereoFile::Format::opencv: {
      const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> R = T_rl.R;
      replace(data_key(yaml, "R"), numbers_text(R.data(), 3, 3, 8));
      replace(data_key(yaml, "T"), numbers_text(T_rl.t.data(), 1, 3, 8));
      for (const char* key : {"E", "F", "R1", "R2", "P1", "P2", "Q"}) replace(key, "");  // of the old pose
      break;
    }
  }
  return out;
}

}  // namespace iclk
