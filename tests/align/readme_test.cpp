// The code of README.md, compiled and run. Lines between "// README" and "// end" stand there word for word.
#include <fstream>
#include <sstream>

#include "host_application.h"
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

Alignment embed(Application& app, const ApplicationCommands& frame, VkImage rendered, const ImageView& view0,
                const Camera& camera, const Features& features) {
  const VkInstance instance = app.instance.handle();
  const VkPhysicalDevice physical_device = app.physical;
  const VkDevice device = app.device;
  const VkQueue queue = app.queue;
  const uint32_t queue_family = app.family;
  const VkCommandBuffer commands = frame.commands;
  const uint32_t width = static_cast<uint32_t>(camera.width), height = static_cast<uint32_t>(camera.height);
  const auto submit_and_wait = [&] {
    frame.end();
    frame.submit_and_wait();
  };
  // README
  // Once: our device is yours, and all memory is allocated here.
  auto context = iclk::engine::adopt_device({.instance = instance,
                                             .physical_device = physical_device,
                                             .device = device,
                                             .queue = queue,
                                             .queue_family = queue_family});
  iclk::Plan plan{.width = camera.width, .height = camera.height, .format = iclk::PixelFormat::rgba8};
  iclk::DeviceAligner aligner(context, plan, {}, iclk::Solver::device);
  auto recording = aligner.make_recording();
  aligner.set_reference(0, {.image = view0, .camera = camera, .features = features});

  // Every frame, behind the commands that render into the image: the whole alignment, into your command buffer.
  iclk::DevicePair pair{.reference = 0};
  pair.target = iclk::engine::ForeignImage{.handle = rendered,
                                           .format = VK_FORMAT_R8G8B8A8_UNORM,
                                           .width = width,
                                           .height = height,
                                           .layout = VK_IMAGE_LAYOUT_GENERAL};
  aligner.record(*recording, commands, {}, {&pair, 1});
  VkBuffer results = recording->results().handle;  // shaders::ResultInfo: pose, covariance, status, for your shaders
  submit_and_wait();
  iclk::Alignment result = recording->read().front();  // the same on the host, with the trace
  // end
  EXPECT_NE(results, VkBuffer{});
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

  Application app;
  ApplicationImage image(app, 160, 120, VK_FORMAT_R8G8B8A8_UNORM, VK_IMAGE_LAYOUT_GENERAL);
  image.fill(app.adopt(), image1.data(), image1.size());
  const ApplicationCommands frame(app);
  const Alignment embedded = embed(app, frame, image.foreign.handle, view0, scene.camera, features);
  EXPECT_TRUE(embedded.converged()) << embedded.reason;
  EXPECT_LT(pixel_error(scene, features, embedded.T_10), 0.05);
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

TEST(Readme, CodeIsThatOfThisFile) {
  const auto here = lines_of(ICLK_SOURCE_DIR "/tests/align/readme_test.cpp"), readme = lines_of(ICLK_SOURCE_DIR "/README.md");
  int blocks = 0;
  for (size_t i = 0; i < here.size(); ++i) {
    if (here[i] != "// README") continue;
    const auto first = here.begin() + static_cast<ptrdiff_t>(i) + 1, last = std::find(first, here.end(), "// end");
    EXPECT_NE(std::search(readme.begin(), readme.end(), first, last), readme.end())
        << "README.md lacks what begins: " << *first;
    ++blocks;
  }
  EXPECT_EQ(blocks, 2);
}

}  // namespace
}  // namespace iclk::test
