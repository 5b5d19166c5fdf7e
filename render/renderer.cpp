#include <iclk/render/renderer.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <string>

#include <Eigen/LU>

#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/error.h>
#include <iclk/engine/submission.h>
#include <iclk/render/internal/text.h>
#include <iclk/render/internal/windows.h>

#include "render.comp.spv.h"

namespace iclk {

using internal::number;

namespace {

using engine::BufferUse;
using engine::MemoryKind;

constexpr uint64_t kWindowElements = 1u << 24;  // available on every device (engine::requirements())
constexpr uint32_t kGroup = 8;                  // local size of render.comp
constexpr int kSmallestTile = 32;               // px; below, a coarser level of the mosaic is used
constexpr int kLargestSide = 32768;

[[noreturn]] void fail(const std::string& why) { throw Error(ErrorCode::invalid_argument, "render: " + why); }

engine::Kernel make_kernel(const std::shared_ptr<const engine::Context>& context, const RenderOptions& options,
                           Distortion::Model model) {
  using enum engine::BindingKind;
  return {
      context,
      {"render",
       render_comp_spv,
       {texel_read, texel_read, uniform, storage_write, storage_write},
       sizeof(shaders::RenderPush),
       {static_cast<uint32_t>(options.samples), static_cast<uint32_t>(options.max_anisotropy), static_cast<uint32_t>(model)}}};
}
static_assert(static_cast<int>(Distortion::Model::none) == ICLK_LENS_NONE);
static_assert(static_cast<int>(Distortion::Model::radtan) == ICLK_LENS_RADTAN);
static_assert(static_cast<int>(Distortion::Model::equidistant) == ICLK_LENS_EQUIDISTANT);

/// Heights, mosaic and the positions of their windows on the device, and the staging memory.
struct DeviceTerrain {
  DeviceTerrain(std::shared_ptr<const engine::Context> c, uint64_t relief_elements, uint64_t mosaic_elements, bool keep_staging)
      : context(std::move(c)) {
    engine::MemoryPlan plan, staging_plan;
    relief = plan.add("relief", 4 * relief_elements, MemoryKind::device, BufferUse::texel, VK_FORMAT_R32_SFLOAT);
    mosaic = plan.add("mosaic", 4 * mosaic_elements, MemoryKind::device, BufferUse::texel, VK_FORMAT_R8G8B8A8_UNORM);
    levels = plan.add("levels", sizeof(shaders::RenderLevels), MemoryKind::device, BufferUse::uniform);
    staging_relief = staging_plan.add("staged relief", 4 * relief_elements, MemoryKind::upload, BufferUse::transfer);
    staging_mosaic = staging_plan.add("staged mosaic", 4 * mosaic_elements, MemoryKind::upload, BufferUse::transfer);
    staging_levels = staging_plan.add("staged levels", sizeof(shaders::RenderLevels), MemoryKind::upload, BufferUse::transfer);
    memory = engine::Workspace(context, plan);
    staging = engine::Workspace(context, staging_plan);
    kept = keep_staging;
  }

  void record_upload(engine::Recorder& recorder, const Windows& r, const Windows& m, const Terrain& terrain,
                     uint32_t background) {
    auto* out = staging[staging_levels].as<shaders::RenderLevels>();
    out->cells_per_metre_x = static_cast<float>(1 / terrain.relief.step_x);
    out->cells_per_metre_y = static_cast<float>(1 / terrain.relief.step_y);
    out->texels_per_metre_x = static_cast<float>(1 / terrain.mosaic.step_x);
    out->texels_per_metre_y = static_cast<float>(1 / terrain.mosaic.step_y);
    out->background = background;
    std::copy(r.levels.begin(), r.levels.end(), out->relief);
    std::copy(m.levels.begin(), m.levels.end(), out->mosaic);
    recorder.copy(staging[staging_relief], memory[relief], 4 * r.elements);
    recorder.copy(staging[staging_mosaic], memory[mosaic], 4 * m.elements);
    recorder.copy(staging[staging_levels], memory[levels], sizeof(shaders::RenderLevels));
  }

  std::shared_ptr<const engine::Context> context;
  engine::BufferId relief, mosaic, levels, staging_relief, staging_mosaic, staging_levels;
  engine::Workspace memory, staging;
  bool kept = false;
};

/// Colour and depth of a view on the device and on the host.
struct Frame {
  Frame(const std::shared_ptr<const engine::Context>& context, uint64_t view_pixels) : pixels(view_pixels) {
    engine::MemoryPlan plan;
    rgba = plan.add("rendered colour", 4 * pixels, MemoryKind::device, BufferUse::storage);
    depth = plan.add("rendered depth", 4 * pixels, MemoryKind::device, BufferUse::storage);
    host_rgba = plan.add("colour to read", 4 * pixels, MemoryKind::readback, BufferUse::transfer);
    host_depth = plan.add("depth to read", 4 * pixels, MemoryKind::readback, BufferUse::transfer);
    memory = engine::Workspace(context, plan);
  }
  uint64_t pixels;
  engine::BufferId rgba, depth, host_rgba, host_depth;
  engine::Workspace memory;
};

}  // namespace

void RenderOptions::check() const {
  if (samples < 1 || samples > 8) fail("samples " + std::to_string(samples) + " must be 1 to 8");
  if (max_anisotropy < 1 || max_anisotropy > 64) fail("anisotropy " + std::to_string(max_anisotropy) + " must be 1 to 64");
}

struct TerrainRenderer::Impl {
  Impl(std::shared_ptr<const engine::Context> c, std::shared_ptr<const Terrain> t, const RenderOptions& o)
      : context(std::move(c)), options(o) {
    options.check();
    kernel_of(Distortion::Model::none);
    engine::ArenaSize size;
    size.add(kernels[0], static_cast<uint32_t>(kernels.size()));
    arena = std::make_unique<engine::DescriptorArena>(context, size);
    submission = std::make_unique<engine::Submission>(context);
    show(std::move(t));
  }

  void show(std::shared_ptr<const Terrain> t) {
    t->check();
    arena->reset();
    device.reset();
    terrain = std::move(t);
    relief = relief_levels(terrain->relief, terrain->height);
    mosaic = mosaic_levels(terrain->mosaic, terrain->rgba);
    highest = relief.back().data[0];
    lowest = highest;
    for (const float h : terrain->height)
      if (h < lowest) lowest = h;  // false for NaN
    place();
    if (resident) upload_whole();
  }

  /// Made when it is first needed: a driver may take a second.
  const engine::Kernel& kernel_of(Distortion::Model model) const {
    engine::Kernel& kernel = kernels[static_cast<size_t>(model)];
    if (!kernel) kernel = make_kernel(context, options, model);
    return kernel;
  }

  /// Copies the whole terrain to the device, or allocates memory for windows.
  void place() {
    const Windows r = whole(relief), m = whole(mosaic);
    if (relief.size() > ICLK_RENDER_LEVELS || mosaic.size() > ICLK_RENDER_LEVELS || (m.elements | r.elements) >> 38)
      throw Error(ErrorCode::unsupported, "render: a mosaic of " + std::to_string(terrain->mosaic.width) + "x" +
                                              std::to_string(terrain->mosaic.height) + " has more than " +
                                              std::to_string(1 << (ICLK_RENDER_LEVELS - 1)) +
                                              " pixels per side; cut it with gdal_translate -projwin");
    VkDeviceSize device_memory = 0;
    const VkPhysicalDeviceMemoryProperties& heaps = context->memory_properties();
    for (uint32_t i = 0; i < heaps.memoryHeapCount; ++i)
      if (heaps.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT)
        device_memory = std::max(device_memory, heaps.memoryHeaps[i].size);
    uint64_t limit = std::min<uint64_t>({context->limits().maxTexelBufferElements, device_memory / 16, uint64_t{1} << 30});
    if (context->storage_reads()) limit = std::min<uint64_t>(limit, context->limits().maxStorageBufferRange / 4);
    if (options.max_texels > 0) limit = std::min(limit, options.max_texels);
    resident = r.elements <= limit && m.elements <= limit;
    if (resident) {
      whole_relief = r, whole_mosaic = m;
      relief_room = r.elements, mosaic_room = m.elements;
    } else {
      relief_room = std::min({limit, kWindowElements, r.elements});
      mosaic_room = std::min({limit, kWindowElements, m.elements});
    }
    device = std::make_unique<DeviceTerrain>(context, relief_room, mosaic_room, !resident);
  }

  void upload_whole() {
    copy_windows(whole_relief, relief, terrain->height, device->staging[device->staging_relief].as<float>());
    copy_windows(whole_mosaic, mosaic, terrain->rgba, device->staging[device->staging_mosaic].as<uint32_t>());
    engine::Recorder recorder(*submission, *arena);
    device->record_upload(recorder, whole_relief, whole_mosaic, *terrain, options.background);
    recorder.finish();
    submission->end();
    submission->submit_and_wait();
    device->staging = engine::Workspace();
    for (auto& level : relief) level.data = {};  // the device has them
    for (auto& level : mosaic) level.data = {};
  }

  void check(const Camera& camera, const SE3& T_WC) const {
    camera.check();
    if (camera.width > kLargestSide || camera.height > kLargestSide)
      fail("a view of " + std::to_string(camera.width) + "x" + std::to_string(camera.height) + " pixels: at most " +
           std::to_string(kLargestSide) + " per side are allowed");
    if (!T_WC.t.allFinite() || !T_WC.R.allFinite()) fail("the pose of the camera has NaN or infinite numbers");
    if (!(T_WC.R * T_WC.R.transpose()).isIdentity(1e-6) || T_WC.R.determinant() < 0)
      fail("the pose of the camera is not a rotation and translation");
    const Eigen::Vector2d cell = terrain->relief.pixel(T_WC.t.x(), T_WC.t.y()),
                          texel = terrain->mosaic.pixel(T_WC.t.x(), T_WC.t.y());
    if (cell.cwiseAbs().maxCoeff() > 1e8 || texel.cwiseAbs().maxCoeff() > 1e8 || std::abs(T_WC.t.z()) > 1e7)
      fail("a camera at " + number(T_WC.t.x()) + ", " + number(T_WC.t.y()) + ", " + number(T_WC.t.z()) +
           " is too far from the map, " + terrain->extent().text());
    const auto ground = terrain->height_at(T_WC.t.x(), T_WC.t.y());
    if (ground && *ground >= T_WC.t.z())
      fail("the camera at " + number(T_WC.t.x()) + ", " + number(T_WC.t.y()) + " is " + number(T_WC.t.z()) +
           " m high, but the ground there is " + number(*ground) + " m high: it must be above the ground");
  }

  shaders::RenderPush push(const Camera& camera, const SE3& T_WC, const Lens& lens, const PixelRect& tile, int finest) const {
    if (!lens.denominator().isZero()) fail("lenses with eight coefficients cannot be rendered; use radtan with at most 5");
    shaders::RenderPush p{};
    Eigen::Matrix3d K_inverse = Eigen::Matrix3d::Identity();
    if (lens.empty()) K_inverse << 1 / camera.fx, 0, -camera.cx / camera.fx, 0, 1 / camera.fy, -camera.cy / camera.fy, 0, 0, 1;
    const Eigen::Matrix3f rays = (T_WC.R * K_inverse).cast<float>();
    for (int i = 0; i < 3; ++i) p.ray_u[i] = rays(i, 0), p.ray_v[i] = rays(i, 1), p.ray_0[i] = rays(i, 2);
    if (!lens.empty()) {
      const double of_lens[] = {lens.limit(), lens.tangential().x(), lens.tangential().y()};
      const double of_camera[] = {camera.fx, camera.fy, camera.cx, camera.cy};
      for (int i = 0; i < 3; ++i) p.ray_0[i] = static_cast<float>(of_lens[i]);
      for (int i = 0; i < 4; ++i) p.lens[i] = static_cast<float>(of_camera[i]);
      for (int i = 0; i < 4; ++i) p.lens[4 + i] = static_cast<float>(lens.radial()[i]);
    }
    p.height_high = static_cast<float>(T_WC.t.z());
    p.height_low = static_cast<float>(T_WC.t.z() - p.height_high);
    p.top = static_cast<float>(highest - T_WC.t.z());
    p.top += 1e-6f * std::abs(p.top);
    const Eigen::Vector2d cell = terrain->relief.pixel(T_WC.t.x(), T_WC.t.y());
    p.cell_x = static_cast<int>(std::floor(cell.x()));
    p.cell_y = static_cast<int>(std::floor(cell.y()));
    p.cell_fraction_x = static_cast<float>(cell.x() - p.cell_x);
    p.cell_fraction_y = static_cast<float>(cell.y() - p.cell_y);
    const Eigen::Vector2d texel = terrain->mosaic.pixel(T_WC.t.x(), T_WC.t.y());
    const int coarsest = static_cast<int>(mosaic.size()) - 1;
    const double corner = std::ldexp(1.0, coarsest);
    p.texel_x = static_cast<int>(corner * std::floor(texel.x() / corner));
    p.texel_y = static_cast<int>(corner * std::floor(texel.y() / corner));
    p.texel_fraction_x = static_cast<float>(texel.x() - p.texel_x);
    p.texel_fraction_y = static_cast<float>(texel.y() - p.texel_y);
    const auto pack = [](int a, int b) { return static_cast<uint32_t>(a) | static_cast<uint32_t>(b) << 16; };
    p.size = pack(camera.width, camera.height);
    p.corner = pack(tile.x, tile.y);
    p.tile = pack(tile.width, tile.height);
    p.levels =
        static_cast<uint32_t>(relief.size() - 2) | static_cast<uint32_t>(coarsest) << 8 | static_cast<uint32_t>(finest) << 16;
    return p;
  }

  void dispatch(engine::Recorder& recorder, const Lens& lens, const shaders::RenderPush& p, const engine::Buffer& rgba,
                const engine::Buffer& depth) const {
    const engine::Workspace& m = device->memory;
    recorder.dispatch(kernel_of(lens.distortion().model),
                      {&m[device->relief], &m[device->mosaic], &m[device->levels], &rgba, &depth}, p,
                      {engine::groups_for(p.tile & 0xffff, kGroup), engine::groups_for(p.tile >> 16, kGroup), 1});
  }

  /// Renders a tile; splits it in halves if its windows do not fit.
  void render_tile(const Camera& camera, const SE3& T_WC, const Lens& lens, const PixelRect& tile) {
    const auto seen = pinhole_box(camera, lens, tile);
    const MapBox box = seen ? footprint(camera, T_WC, *seen, lowest, highest, terrain->relief.centres()) : MapBox();
    int finest = 0;
    Windows r, m;
    if (!box.empty()) {
      r = relief_windows(relief, terrain->relief, box);
      m = mosaic_windows(mosaic, terrain->mosaic, box, finest);
      const bool small = tile.width <= kSmallestTile && tile.height <= kSmallestTile;
      if ((r.elements > relief_room || m.elements > mosaic_room) && !small) {
        PixelRect a = tile, b = tile;
        if (tile.width >= tile.height)
          a.width = (tile.width + 1) / 2, b.x += a.width, b.width -= a.width;
        else
          a.height = (tile.height + 1) / 2, b.y += a.height, b.height -= a.height;
        render_tile(camera, T_WC, lens, a);
        render_tile(camera, T_WC, lens, b);
        return;
      }
      if (r.elements > relief_room)
        throw Error(ErrorCode::unsupported,
                    "render: " + std::to_string(r.elements) + " heights lie under " + std::to_string(tile.width) + "x" +
                        std::to_string(tile.height) + " pixels of the view, but the device takes at most " +
                        std::to_string(relief_room) + "; look down more steeply, or use a coarser elevation (gdalwarp -tr)");
      while (m.elements > mosaic_room && finest + 1 < static_cast<int>(mosaic.size()))
        m = mosaic_windows(mosaic, terrain->mosaic, box, ++finest);
    }
    copy_windows(r, relief, terrain->height, device->staging[device->staging_relief].as<float>());
    copy_windows(m, mosaic, terrain->rgba, device->staging[device->staging_mosaic].as<uint32_t>());
    if (r.elements == 0) r.elements = m.elements = 1;  // no ground: empty windows, which stop every ray
    engine::Recorder recorder(*submission, *arena);
    device->record_upload(recorder, r, m, *terrain, options.background);
    dispatch(recorder, lens, push(camera, T_WC, lens, tile, finest), frame->memory[frame->rgba], frame->memory[frame->depth]);
    recorder.finish();
    submission->end();
    submission->submit_and_wait();
  }

  View render(const Camera& camera, const SE3& T_WC, const Lens& lens) {
    check(camera, T_WC);
    make_frame(camera);
    const PixelRect all{0, 0, camera.width, camera.height};
    if (!resident) render_tile(camera, T_WC, lens, all);
    engine::Recorder recorder(*submission, *arena);
    if (resident)
      dispatch(recorder, lens, push(camera, T_WC, lens, all, 0), frame->memory[frame->rgba], frame->memory[frame->depth]);
    return read(recorder, camera);
  }

  View render_rows(const Camera& camera, std::span<const SE3> T_WC, const Lens& lens) {
    camera.check();
    if (T_WC.size() != static_cast<size_t>(camera.height))
      fail(std::to_string(T_WC.size()) + " poses for " + std::to_string(camera.height) + " rows");
    need_resident("with a rolling shutter");
    for (const SE3& pose : T_WC) check(camera, pose);
    make_frame(camera);
    engine::Recorder recorder(*submission, *arena);
    for (int v = 0; v < camera.height; ++v)
      dispatch(recorder, lens, push(camera, T_WC[static_cast<size_t>(v)], lens, {0, v, camera.width, 1}, 0),
               frame->memory[frame->rgba], frame->memory[frame->depth]);
    return read(recorder, camera);
  }

  void need_resident(const std::string& how) const {
    if (!resident)
      throw Error(ErrorCode::unsupported, "render: a terrain that does not fit into the device (" +
                                              std::to_string(terrain->mosaic.width) + "x" +
                                              std::to_string(terrain->mosaic.height) + " pixels) cannot be rendered " + how +
                                              "; use a smaller or coarser terrain");
  }

  void make_frame(const Camera& camera) {
    const auto pixels = static_cast<uint64_t>(camera.width) * static_cast<uint64_t>(camera.height);
    if (frame && frame->pixels >= pixels) return;
    frame.reset();
    arena->reset();
    frame = std::make_unique<Frame>(context, pixels);
  }

  /// Submits the recorded commands, and waits.
  View read(engine::Recorder& recorder, const Camera& camera) {
    const auto pixels = static_cast<uint64_t>(camera.width) * static_cast<uint64_t>(camera.height);
    const engine::Workspace& m = frame->memory;
    recorder.copy(m[frame->rgba], m[frame->host_rgba], 4 * pixels);
    recorder.copy(m[frame->depth], m[frame->host_depth], 4 * pixels);
    recorder.host_read({&m[frame->host_rgba], &m[frame->host_depth]});
    recorder.finish();
    submission->end();
    submission->submit_and_wait();
    View view{camera.width, camera.height, std::vector<uint32_t>(pixels), std::vector<float>(pixels)};
    std::memcpy(view.rgba.data(), m[frame->host_rgba].mapped, 4 * pixels);
    std::memcpy(view.depth.data(), m[frame->host_depth].mapped, 4 * pixels);
    return view;
  }

  std::shared_ptr<const engine::Context> context;
  std::shared_ptr<const Terrain> terrain;
  RenderOptions options;
  mutable std::array<engine::Kernel, 3> kernels;  // by Distortion::Model
  std::vector<RasterLevel<float>> relief;         // with data only if the terrain is not resident
  std::vector<RasterLevel<uint32_t>> mosaic;      // the same
  double lowest = 0, highest = 0;
  bool resident = false;
  Windows whole_relief, whole_mosaic;
  uint64_t relief_room = 0, mosaic_room = 0;
  std::unique_ptr<DeviceTerrain> device;
  std::unique_ptr<Frame> frame;
  std::unique_ptr<engine::DescriptorArena> arena;
  std::unique_ptr<engine::Submission> submission;
};

TerrainRenderer::TerrainRenderer(std::shared_ptr<const engine::Context> context, std::shared_ptr<const Terrain> terrain,
                                 const RenderOptions& options)
    : impl_(std::make_unique<Impl>(std::move(context), std::move(terrain), options)) {}
TerrainRenderer::~TerrainRenderer() = default;
TerrainRenderer::TerrainRenderer(TerrainRenderer&&) noexcept = default;
TerrainRenderer& TerrainRenderer::operator=(TerrainRenderer&&) noexcept = default;

const Terrain& TerrainRenderer::terrain() const { return *impl_->terrain; }
void TerrainRenderer::show(std::shared_ptr<const Terrain> terrain) { impl_->show(std::move(terrain)); }
bool TerrainRenderer::resident() const { return impl_->resident; }
View TerrainRenderer::render(const Camera& camera, const SE3& T_WC, const Lens& lens) {
  return impl_->render(camera, T_WC, lens);
}
View TerrainRenderer::render_rows(const Camera& camera, std::span<const SE3> T_WC, const Lens& lens) {
  return impl_->render_rows(camera, T_WC, lens);
}

void TerrainRenderer::record(engine::Recorder& recorder, const Camera& camera, const SE3& T_WC, const engine::Buffer& rgba,
                             const engine::Buffer& depth, const Lens& lens) const {
  impl_->check(camera, T_WC);
  impl_->need_resident("by record(), by render() only");
  const uint64_t bytes = uint64_t{4} * static_cast<uint64_t>(camera.width) * static_cast<uint64_t>(camera.height);
  if (rgba.size < bytes || depth.size < bytes)
    fail("buffers of " + std::to_string(rgba.size) + " and " + std::to_string(depth.size) + " bytes for a view of " +
         std::to_string(bytes));
  impl_->dispatch(recorder, lens, impl_->push(camera, T_WC, lens, {0, 0, camera.width, camera.height}, 0), rgba, depth);
}

void TerrainRenderer::add_to(engine::ArenaSize& size, uint32_t views) const { size.add(impl_->kernels[0], views); }

}  // namespace iclk
