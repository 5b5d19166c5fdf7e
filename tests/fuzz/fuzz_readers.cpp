// Any bytes are what a reader of files wants or an error that names the file: images, depth, features, camera, poses, manifest
// or geotiff, as ICLK_READER says.
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <string>

#include <iclk/engine/error.h>
#include <iclk/render/geotiff.h>
#include <iclk/session/io/camera_file.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/pose_text.h>

#include "apps/iclk/io/images.h"
#include "apps/json/manifest.h"

namespace {

constexpr uint64_t kPixels = 1 << 16;  // libraries of codecs are not what is looked into

void read_manifest_lines(const std::string& path) {
  const iclk::Manifest manifest = iclk::read_manifest(path);
  for (const iclk::ManifestLine& line : manifest.lines) {
    try {
      const iclk::PairRequest request = iclk::parse_line(manifest, line);
      if (request.files.reference.empty() || request.files.target.empty()) std::abort();
      if (nlohmann::ordered_json::parse(request.meta.dump()) != request.meta) std::abort();
    } catch (const iclk::Error& e) {
      if (!std::string(e.what()).starts_with(iclk::place(manifest, line)) && e.code() != iclk::ErrorCode::io) std::abort();
    } catch (const nlohmann::json::exception&) {  // dump() of text that is not UTF-8
    }
  }
}

const std::map<std::string, std::function<void(const std::string&)>> kReaders = {
    {"images",
     [](const std::string& path) {
       const auto header = iclk::peek_image(path, kPixels);
       const cv::Mat image = iclk::load_image(path, kPixels);
       if (!header || image.total() > kPixels || image.total() != header->width * header->height) std::abort();
       iclk::view(image);
     }},
    {"depth", [](const std::string& path) { iclk::load_depth(path, 1000, kPixels); }},
    {"features",
     [](const std::string& path) {
       const iclk::Features features = iclk::load_features(path);
       if (features.uv.size() != features.inverse_depth.size()) std::abort();
     }},
    {"camera", [](const std::string& path) { iclk::fit_camera(iclk::load_camera(path), 640, 480).check(); }},
    {"poses",
     [](const std::string& path) {
       for (const iclk::StampedPose& pose : iclk::load_trajectory(path))
         if (!pose.T_wc.t.allFinite()) std::abort();
     }},
    {"pose",
     [](const std::string& path) {
       if (!iclk::load_pose(path, "pose").R.allFinite()) std::abort();
     }},
    {"manifest", read_manifest_lines},
    {"geotiff", [](const std::string& path) { iclk::GeoMap(path, path).whole(); }},
};

std::function<void(const std::string&)> g_read;
std::string g_path;
int g_file = -1;

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  const char* name = std::getenv("ICLK_READER");
  const auto found = kReaders.find(name == nullptr ? "" : name);
  if (found == kReaders.end()) {
    std::fprintf(stderr, "ICLK_READER must be one of:");
    for (const auto& [known, read] : kReaders) std::fprintf(stderr, " %s", known.c_str());
    std::fprintf(stderr, "\n");
    std::exit(2);
  }
  g_read = found->second;
  g_file = memfd_create("iclk_fuzz", MFD_CLOEXEC);
  g_path = "/proc/self/fd/" + std::to_string(g_file);
  iclk::prepare_opencv();
  return g_file < 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (ftruncate(g_file, 0) != 0 || pwrite(g_file, data, size, 0) != static_cast<ssize_t>(size)) std::abort();
  try {
    g_read(g_path);
  } catch (const iclk::Error& e) {  // any other exception ends the run
    if (std::string(e.what()).empty()) std::abort();
  }
  return 0;
}
