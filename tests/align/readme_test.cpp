// The code of README.md, compiled and run, here or by the embedding example. Lines between "// README" and "// end" stand there
// word for word.
#include <fstream>
#include <sstream>

#include "solvers.h"

namespace iclk::test {
namespace {

struct Point {
  double u, v, depth;
};

Alignment align_two(const ImageView& view0, const ImageView& view1, const Camera& c, const std::vector<Point>& points) {
  const double fx = c.fx, fy = c.fy, cx = c.cx, cy = c.cy;
  const int width = c.width, height = c.height;
  // README
  auto context = iclk::engine::create_context();  // the best Vulkan device; make_cpu_aligner() needs none
  auto aligner = iclk::make_device_aligner(context, {.width = width, .height = height});
  iclk::Reference keyframe{.image = view0, .camera = {fx, fy, cx, cy, width, height}};
  for (const auto& p : points) {
    keyframe.features.uv.push_back({p.u, p.v});
    keyframe.features.inverse_depth.push_back(1 / p.depth);
  }
  aligner->set_reference(0, keyframe);                         // prepared once, for any number of targets
  iclk::Alignment result = aligner->align({.target = view1});  // T_10, covariance, status, trace
  if (!result.converged()) std::puts(result.reason.c_str());
  // end
  return result;
}

std::vector<uint8_t> rgba(const Frame& frame) {
  std::vector<uint8_t> bytes;
  for (float I : frame.data)
    for (int c = 0; c < 4; ++c) bytes.push_back(static_cast<uint8_t>(std::lround(255 * std::clamp(I, 0.0f, 1.0f))));
  return bytes;
}

TEST(Readme, CodeWorks) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.T_10.t.x() = 0.05;
  const Features features = random_features(scene, 50);
  std::vector<Point> points;
  for (size_t i = 0; i < features.uv.size(); ++i)
    points.push_back({features.uv[i].x(), features.uv[i].y(), 1 / features.inverse_depth[i]});
  const auto image0 = rgba(render(scene, 0)), image1 = rgba(render(scene, 1));
  const ImageView view0{image0.data(), 160, 120, 0, PixelFormat::rgba8}, view1{image1.data(), 160, 120, 0, PixelFormat::rgba8};
  const Alignment two = align_two(view0, view1, scene.camera, points);
  EXPECT_TRUE(two.converged()) << two.reason;
  EXPECT_LT(pixel_error(scene, features, two.T_10), 0.05);
}

// Lines of a file without their indent.
std::vector<std::string> lines_of(const std::string& path) {
  std::ifstream file(path);
  EXPECT_TRUE(file.good()) << path;
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);)
    lines.push_back(line.substr(std::min(line.find_first_not_of(' '), line.size())));
  return lines;
}

TEST(Readme, CodeIsWhatIsCompiled) {
  const auto readme = lines_of(ICLK_SOURCE_DIR "/README.md");
  int blocks = 0;
  for (const char* file : {"/tests/align/readme_test.cpp", "/apps/embed/run.cpp"}) {
    const auto code = lines_of(std::string(ICLK_SOURCE_DIR) + file);
    auto after = readme.begin();  // blocks of a file come in its order
    for (size_t i = 0; i < code.size(); ++i) {
      if (code[i] != "// README") continue;
      const auto first = code.begin() + static_cast<ptrdiff_t>(i) + 1, last = std::find(first, code.end(), "// end");
      const auto found = std::search(after, readme.end(), first, last);
      EXPECT_NE(found, readme.end()) << "README.md lacks what begins, in " << file << ": " << *first;
      if (found != readme.end()) after = found + (last - first);
      ++blocks;
    }
  }
  EXPECT_EQ(blocks, 4);
}

}  // namespace
}  // namespace iclk::test
