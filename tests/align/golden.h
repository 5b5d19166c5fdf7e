#pragma once
#include <cstring>
#include <fstream>
#include <map>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <iclk/align/aligner.h>

namespace iclk::test {

/// A golden case: exact outputs of the executable specification, float64 arithmetic stored as float32.
class Golden {
 public:
  struct Tensor {
    std::vector<size_t> shape;
    std::vector<float> data;
  };

  explicit Golden(const std::string& name) {
    const std::string path = std::string(ICLK_GOLDEN_DIR) + "/" + name + ".safetensors";
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error("golden file " + path + " is missing");
    uint64_t header_size = 0;
    file.read(reinterpret_cast<char*>(&header_size), sizeof header_size);
    std::string header(header_size, ' ');
    file.read(header.data(), static_cast<std::streamsize>(header_size));
    const std::vector<char> blob((std::istreambuf_iterator<char>(file)), {});
    const nlohmann::json tensors = nlohmann::json::parse(header);
    for (const auto& [key, value] : tensors.items()) {
      if (key == "__metadata__") continue;
      Tensor t;
      t.shape = value["shape"].get<std::vector<size_t>>();
      const auto begin = value["data_offsets"][0].get<size_t>(), end = value["data_offsets"][1].get<size_t>();
      t.data.resize((end - begin) / sizeof(float));
      std::memcpy(t.data.data(), blob.data() + begin, end - begin);
      tensors_[key] = std::move(t);
    }
  }

  const Tensor& operator[](const std::string& key) const { return tensors_.at(key); }
  bool has(const std::string& key) const { return tensors_.count(key) > 0; }
  const Tensor& level(int l, const std::string& key) const { return tensors_.at("level" + std::to_string(l) + "." + key); }

  int width() const { return static_cast<int>((*this)["image0"].shape[3]); }
  int height() const { return static_cast<int>((*this)["image0"].shape[2]); }

  Camera camera() const {
    const auto& k = (*this)["camera"].data;
    return {k[0], k[1], k[2], k[3], width(), height()};
  }

  Features features() const {
    Features f;
    const auto &uv = (*this)["features"].data, &q = (*this)["inverse_depth"].data;
    for (size_t i = 0; i < q.size(); ++i) {
      f.uv.emplace_back(uv[2 * i], uv[2 * i + 1]);
      f.inverse_depth.push_back(q[i]);
    }
    return f;
  }

  /// Planar (3, H, W) to interleaved RGB.
  std::vector<float> rgb(const std::string& key) const {
    const auto& planes = (*this)[key].data;
    const size_t n = planes.size() / 3;
    std::vector<float> out(planes.size());
    for (size_t i = 0; i < n; ++i)
      for (size_t c = 0; c < 3; ++c) out[3 * i + c] = planes[c * n + i];
    return out;
  }
  ImageView view(const std::vector<float>& rgb) const { return {rgb.data(), width(), height(), 0, PixelFormat::rgb32f}; }

  static SE3 pose(const float* R, const float* t) {
    SE3 T;
    for (int i = 0; i < 9; ++i) T.R(i / 3, i % 3) = R[i];
    T.t = {t[0], t[1], t[2]};
    return T;
  }
  SE3 truth() const { return pose((*this)["R_gt"].data.data(), (*this)["t_gt"].data.data()); }
  SE3 result() const { return pose((*this)["R"].data.data(), (*this)["t"].data.data()); }

  /// The specification's settings: fixed lambda 1e-6, 10 iterations whatever happens, no weights, no gain and bias.
  static AlignerOptions paper_options() {
    AlignerOptions o;
    o.robust = Robust::unit;
    o.photometric = false;
    o.step_tolerance = 0;
    return o;
  }

 private:
  std::map<std::string, Tensor> tensors_;
};

}  // namespace iclk::test
