#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/image.h>
#include <iclk/align/lens.h>
#include <iclk/align/se3.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/context.h>
#include <iclk/render/terrain.h>

namespace iclk {

struct RenderOptions {
  int samples = 2;                   ///< rays a pixel and side: colour is the mean of samples x samples; 1 to 8
  int max_anisotropy = 16;           ///< looks into the mosaic along the long axis of a ray's footprint, at most; 1 to 64
  uint32_t background = 0xff000000;  ///< rgba8, R in the lowest byte, where nothing is seen
  /// Elements of one texel buffer, 0: as many as the device takes, at most a quarter of its memory. A terrain that does not fit
  /// is rendered from windows of at most 2^24 elements that are copied to the device for each view.
  uint64_t max_texels = 0;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// What a camera sees.
struct View {
  int width = 0, height = 0;
  std::vector<uint32_t> rgba;  ///< row-major, R in the lowest byte, alpha 255
  std::vector<float> depth;    ///< m along the optical axis at the pixel's centre; 0: no ground, or ground without a picture

  ImageView image() const { return {rgba.data(), width, height, 0, PixelFormat::rgba8}; }
  ImageView depth_image() const { return {depth.data(), width, height, 0, PixelFormat::r32f}; }
};

/// Renders views of a terrain by ray casting in a compute shader. A camera is given by T_WC, which maps its points (x right, y
/// down, z forward) into the map (x east, y north, z up), and by its lens: a pixel looks in the direction that the lens bends
/// into it, and pixels outside the lens's domain see nothing. Colours are interpolated as they are stored, without a gamma. The
/// same view on the same device has the same bits. One thread at a time.
class TerrainRenderer {
 public:
  /// Builds the pyramids and, where they fit, copies them to the device. Keeps the terrain alive.
  /// Throws Error(invalid_argument) of Terrain::check and RenderOptions::check, Error(unsupported), Error(out_of_memory).
  TerrainRenderer(std::shared_ptr<const engine::Context> context, std::shared_ptr<const Terrain> terrain,
                  const RenderOptions& options = {});
  ~TerrainRenderer();
  TerrainRenderer(TerrainRenderer&&) noexcept;
  TerrainRenderer& operator=(TerrainRenderer&&) noexcept;

  const Terrain& terrain() const;

  /// Renders and waits. Throws Error(invalid_argument) for an invalid camera, a pose that is no rigid motion or lies at or
  /// below the ground; Error(unsupported) if heights under the view do not fit into the device; Error(device_lost).
  View render(const Camera& camera, const SE3& T_WC, const Lens& lens = {});
  /// A rolling shutter: row v from T_WC[v], its depth along that pose's axis. Throws as render(), Error(invalid_argument) for
  /// another number of poses than rows, and Error(unsupported) unless resident().
  View render_rows(const Camera& camera, std::span<const SE3> T_WC, const Lens& lens = {});

  /// The whole terrain is on the device: record() can be used.
  bool resident() const;
  /// Records a view into the application's commands. `rgba` and `depth` are storage buffers of width x height x 4 bytes at
  /// least, rows packed, as in View. Any number of views may be in one command buffer; the renderer must outlive it. Throws as
  /// render() does, and Error(unsupported) unless resident().
  void record(engine::Recorder& recorder, const Camera& camera, const SE3& T_WC, const engine::Buffer& rgba,
              const engine::Buffer& depth, const Lens& lens = {}) const;
  /// Adds what `views` recordings need of a DescriptorArena.
  void add_to(engine::ArenaSize& size, uint32_t views = 1) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
