#include "apps/embed/run.h"

#include <chrono>
#include <cmath>

#include <iclk/align/device_aligner.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/result.h>
#include <iclk/refine/device_refiner.h>
#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>

#include "apps/embed/flight.h"
#include "apps/embed/marks.h"
#include "apps/embed/picture.h"
#include "apps/embed/timestamps.h"

namespace embed {
namespace {

using Clock = std::chrono::steady_clock;

double milliseconds(Clock::duration d) { return std::chrono::duration<double, std::milli>(d).count(); }

/// A terrain renderer that leaves colours and depths in buffers of the application, from where they go into its images.
class Renderer {
 public:
  Renderer(Host& host, const std::shared_ptr<iclk::engine::Context>& context, const iclk::Terrain& terrain,
           const iclk::Camera& camera)
      : camera_(camera),
        renderer_(context, std::make_shared<const iclk::Terrain>(terrain)),
        arena_(context, room(renderer_)),
        context_(context),
        colour0_(host, bytes(camera), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT),
        colour1_(host, bytes(camera), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT),
        depth0_(host, bytes(camera), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT),
        depth1_(host, bytes(camera), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT) {}

  /// Both views and the depth of the first one, into images.
  void record(VkCommandBuffer commands, const iclk::SE3& T_W0, const iclk::SE3& T_W1, const Image& view0, const Image& depth0,
              const Image& view1) {
    iclk::engine::Recorder recorder(*context_, commands, arena_);
    const iclk::engine::Buffer rgba0{.handle = colour0_.handle, .size = colour0_.size},
        rgba1{.handle = colour1_.handle, .size = colour1_.size}, z0{.handle = depth0_.handle, .size = depth0_.size},
        z1{.handle = depth1_.handle, .size = depth1_.size};
    renderer_.record(recorder, camera_, T_W0, rgba0, z0);
    renderer_.record(recorder, camera_, T_W1, rgba1, z1);
    recorder.publish({&rgba0, &z0, &rgba1});
    view0.record_fill(commands, colour0_.handle);
    depth0.record_fill(commands, depth0_.handle);
    view1.record_fill(commands, colour1_.handle);
  }

 private:
  static VkDeviceSize bytes(const iclk::Camera& c) {
    return 4 * static_cast<VkDeviceSize>(c.width) * static_cast<VkDeviceSize>(c.height);
  }
  static iclk::engine::ArenaSize room(const iclk::TerrainRenderer& renderer) {
    iclk::engine::ArenaSize size;
    renderer.add_to(size, 2);
    return size;
  }

  iclk::Camera camera_;
  iclk::TerrainRenderer renderer_;
  iclk::engine::DescriptorArena arena_;  // the same buffers every frame: filled once
  std::shared_ptr<const iclk::engine::Context> context_;
  Buffer colour0_, colour1_, depth0_, depth1_;
};

/// Mean distance of the features' places in image 1 by two poses; infinite if one puts a feature behind the camera, or without
/// features.
double pixels_apart(const iclk::Camera& camera, const iclk::Features& features, const iclk::SE3& a, const iclk::SE3& b) {
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < features.uv.size(); ++i) {
    if (!(features.inverse_depth[i] > 0)) continue;
    ++count;
    const Eigen::Vector3d X = camera.ray(features.uv[i]) / features.inverse_depth[i];
    if ((a * X).z() <= 0 || (b * X).z() <= 0) return INFINITY;
    sum += (camera.project(a * X) - camera.project(b * X)).norm();
  }
  return count > 0 ? sum / count : INFINITY;
}

}  // namespace

Report run(const Options& options) {
  const double f = 0.9 * options.width;
  const iclk::Camera camera{f, f, 0.5 * (options.width - 1), 0.5 * (options.height - 1), options.width, options.height};
  const auto width = static_cast<uint32_t>(options.width), height = static_cast<uint32_t>(options.height);
  const iclk::Terrain terrain = iclk::procedural_terrain({.seed = options.seed, .size = 512});

  Report report;
  {
    Host host(options.device, options.validate);
    report.device = host.device_name;
    report.cpu_unasked = host.cpu_unasked;
    const Image reference(host, width, height), target(host, width, height);
    const Image depth(host, width, height, VK_FORMAT_R32_SFLOAT);
    // README
    // Once: our device is yours, and all memory is allocated here.
    auto context = iclk::engine::adopt_device({.instance = host.instance,
                                               .physical_device = host.physical_device,
                                               .device = host.device,
                                               .queue = host.queue,
                                               .queue_family = host.queue_family});
    iclk::Plan plan{.width = camera.width, .height = camera.height, .max_features = options.features, .choose_features = true};
    iclk::DeviceAligner aligner(context, plan, {}, iclk::Solver::device);
    iclk::DeviceRefiner refiner(aligner);
    auto recording = refiner.make_recording();
    auto image = [&](VkImage handle) {
      return iclk::engine::ForeignImage{handle, VK_FORMAT_R8G8B8A8_UNORM, width, height, VK_IMAGE_LAYOUT_GENERAL};
    };
    // end
    Renderer renderer(host, context, terrain, camera);
    Marks marks(host, recording->results().handle, recording->alignment().features().handle,
                static_cast<uint32_t>(options.features), reference, target);
    Timestamps timestamps(host, 3);

    iclk::SE3 T_W0 = camera_pose(terrain, 0);
    for (int frame = 1; frame <= options.frames; ++frame) {
      // The map is seen from where the camera was found in the frame before, so the first guess is no motion at all, and the
      // reference is new in every frame. A keyframe that stays would be given once, and no references here.
      const iclk::SE3 T_W1 = camera_pose(terrain, frame), truth = T_W1.inverse() * T_W0;

      const auto start = Clock::now();
      VkCommandBuffer commands = host.begin();
      timestamps.record_start(commands);
      renderer.record(commands, T_W0, T_W1, reference, depth, target);
      timestamps.record(commands);
      // README
      // Every frame, behind the commands that render both images: alignment and refinement, into your command buffer.
      // The device chooses features where your depth image says how far they are.
      iclk::DeviceDepth metres{.view = {depth.view, VK_IMAGE_LAYOUT_GENERAL, width, height}};
      iclk::DeviceReference keyframe{.slot = 0, .image = image(reference.handle), .camera = camera, .depth = metres};
      iclk::DevicePair pair{.reference = 0, .target = image(target.handle)};
      refiner.record(*recording, commands, {&keyframe, 1}, {&pair, 1});
      // end
      timestamps.record(commands);
      // README
      // Your shaders read recording->results(), a VkBuffer of shaders::RefinedInfo.
      marks.record(commands, camera, truth);
      host.submit_and_wait();
      iclk::RefinedAlignment result = recording->read().front();  // the same on the host, with the trace
      // end
      FrameReport r{.status = result.status};
      r.ms = milliseconds(Clock::now() - start);
      const iclk::Features features = recording->alignment().read_features().front();
      r.start_px = pixels_apart(camera, features, {}, truth);
      r.error_px = pixels_apart(camera, features, result.T_10, truth);
      const iclk::SE3 off = result.T_10.inverse() * truth;
      r.error_m = off.t.norm(), r.error_rad = off.angle();
      const std::vector<double> parts = timestamps.read();
      if (parts.size() == 2) r.render_ms = parts[0], r.align_ms = parts[1];
      report.frames.push_back(r);
      if (!result.converged()) continue;  // from where it was found last
      T_W0 = T_W0 * result.T_10.inverse();
      T_W0.orthonormalize();
    }
    write_picture(host, reference, target, options.out);
    report.validation_messages = host.messages();
  }
  return report;
}

}  // namespace embed
