#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/image.h>
#include <iclk/align/lens.h>
#include <iclk/align/se3.h>
#include <iclk/engine/context.h>
#include <iclk/render/terrain.h>

namespace iclk::engine {
class Recorder;
struct ArenaSize;
struct Buffer;
}  // namespace iclk::engine

namespace iclk {

struct RenderOptions {
  int samples = 2;                   ///< colour is the mean of samples x samples rays per pixel; 1 to 8
  int max_anisotropy = 16;           ///< most samples of the mosaic along the long axis of a ray's footprint; 1 to 64
  uint32_t background = 0xff000000;  ///< colour without ground, rgba8, R in the lowest byte
  /// The most elements of one texel buffer. 0: the limit of the device, at most a quarter of its memory. For a larger terrain,
  /// windows of at most 2^24 elements are copied to the device for each view.
  uint64_t max_texels = 0;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// A rendered view.
struct View {
  int width = 0, height = 0;
  std::vector<uint32_t> rgba;  ///< row-major, R in the lowest byte, alpha 255
  std::vector<float> depth;    ///< m along the optical axis at the pixel's centre; 0: no ground, or ground without a picture

  ImageView image() const { return {rgba.data(), width, height, 0, PixelFormat::rgba8}; }
  ImageView depth_image() const { return {depth.data(), width, height, 0, PixelFormat::r32f}; }
};

/// Renders views of a terrain by ray casting in a compute shader. T_WC maps points of the camera (x right, y down, z forward)
/// to the map (x east, y north, z up). The ray of each pixel is undistorted by the lens; pixels outside its domain show the
/// background. Stored colours are interpolated without gamma. Equal views on the same device are bit-identical. One thread at a
/// time.
class TerrainRenderer {
 public:
  /// Builds the pyramids and copies them to the device if they fit. Keeps the terrain alive.
  /// Throws the errors of Terrain::check() and RenderOptions::check(); Error(unsupported); Error(out_of_memory).
  TerrainRenderer(std::shared_ptr<const engine::Context> context, std::shared_ptr<const Terrain> terrain,
                  const RenderOptions& options = {});
  ~TerrainRenderer();
  TerrainRenderer(TerrainRenderer&&) noexcept;
  TerrainRenderer& operator=(TerrainRenderer&&) noexcept;

  const Terrain& terrain() const;
  /// Renders another terrain from here on; commands that record() wrote before are void. Throws the errors of the constructor;
  /// the renderer is then of no further use.
  void show(std::shared_ptr<const Terrain> terrain);

  /// Renders a view and waits for it. Throws Error(invalid_argument) for an invalid camera, and for a pose that is not a rigid
  /// motion or is not above the ground; Error(unsupported) if the heights below the view do not fit on the device;
  /// Error(device_lost).
  View render(const Camera& camera, const SE3& T_WC, const Lens& lens = {});
  /// Renders with a rolling shutter: row v from T_WC[v], with depth along the axis of that pose. Throws the errors of render();
  /// Error(invalid_argument) unless there is one pose per row; Error(unsupported) unless resident().
  View render_rows(const Camera& camera, std::span<const SE3> T_WC, const Lens& lens = {});

  /// Whether the whole terrain is on the device, as record() requires.
  bool resident() const;
  /// Records a view into the application's commands. `rgba` and `depth` are storage buffers of at least width x height x 4
  /// bytes, with packed rows, as in View. One command buffer may have any number of views; the renderer must outlive it. Throws
  /// the errors of render(), and Error(unsupported) unless resident().
  void record(engine::Recorder& recorder, const Camera& camera, const SE3& T_WC, const engine::Buffer& rgba,
              const engine::Buffer& depth, const Lens& lens = {}) const;
  /// Adds the descriptors of `views` recordings.
  void add_to(engine::ArenaSize& size, uint32_t views = 1) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
